"""What the field hands to the mesher: one chunk's densities on the lattice, apron included."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadParameter
from chunkserver.grid import MASK_MAX, ChunkShape, check_shape


@dataclass(frozen=True, slots=True)
class Samples:
    """One chunk's samples, in cell units of that chunk.

    density: (n, n, n) float32, C order, axes (y, z, x), voxels, finite, negative = rock, else air; n = `shape.samples`.
        The sample of cell unit (cx, cy, cz) is `density[cy + apron, cz + apron, cx + apron]`. y comes first so that a
        horizontal plane is contiguous: what depends on (x, z) alone is worked out once and used for every plane. Where
        no mesh reads more than the sign, more need not be right (`field.sample_near_surface`).

    coarser: mask of the faces whose neighbour is one level coarser, bits -x +x -y +y -z +z = 1 2 4 8 16 32.
    coarse: float32, C order, axes (y, z, x) too: the next level's densities around those faces, `coarse_box`; None
        without such a face.

    Raises `BadParameter` if an array does not have that shape, dtype and order. The values are not looked at: the
    field clamps them.
    """

    shape: ChunkShape
    density: NDArray[np.float32]
    coarser: int = 0
    coarse: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        check_shape(self.shape)
        _check(self.density, (self.shape.samples,) * 3)
        if not 0 <= self.coarser <= MASK_MAX:
            raise BadParameter(f"coarser is {self.coarser}; it is a mask of six faces", coarser=self.coarser)
        if (self.coarse is None) is bool(self.coarser):
            raise BadParameter(f"coarser is {self.coarser}; coarse samples go with it", coarser=self.coarser)
        if self.coarse is not None:
            _check(self.coarse, coarse_box(self.shape.cells, self.coarser).shape)


class Box(NamedTuple):
    """A box of coarse corners of a chunk. low: x, y, z of the first, in coarse cells; shape: how many, (y, z, x)."""

    low: tuple[int, int, int]
    shape: tuple[int, int, int]


@cache
def coarse_box(cells: int, mask: int) -> Box:
    """Return which coarse corners are sampled for a mask of faces: all on them, and one step around.

    One face needs three layers. For more, the whole chunk is as many samples as six times three layers.
    """
    last, single = cells // 2 + 1, mask.bit_count() == 1
    low, high = [-1] * 3, [last] * 3
    if single:
        axis, far = divmod(mask.bit_length() - 1, 2)
        low[axis], high[axis] = (last - 2, last) if far else (-1, 1)
    x, y, z = (end - start + 1 for start, end in zip(low, high, strict=True))
    return Box((low[0], low[1], low[2]), (y, z, x))


def _check(density: NDArray[np.float32], shape: tuple[int, int, int]) -> None:
    if density.shape != shape:
        raise BadParameter(f"density is {density.shape}; it must be {shape}", shape=shape)
    if density.dtype != np.float32:
        raise BadParameter(f"density is {density.dtype}; it must be float32", dtype=str(density.dtype))
    if not density.flags.c_contiguous:
        raise BadParameter("density is not in C order", strides=density.strides)
