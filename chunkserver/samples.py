"""What the field hands to the mesher: one chunk's densities on the lattice, apron included."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadParameter
from chunkserver.grid import ChunkShape, check_shape


@dataclass(frozen=True, slots=True)
class Samples:
    """One chunk's samples, in cell units of that chunk.

    density: (n, n, n) float32, C order, axes (y, z, x), voxels, finite, negative = rock, else air; n = `shape.samples`.
        The sample of cell unit (cx, cy, cz) is `density[cy + apron, cz + apron, cx + apron]`. y comes first so that a
        horizontal plane is contiguous: what depends on (x, z) alone is worked out once and used for every plane.

    Raises `BadParameter` if the array does not have that shape, dtype and order. The values are not looked at: the
    field clamps them.
    """

    shape: ChunkShape
    density: NDArray[np.float32]

    def __post_init__(self) -> None:
        check_shape(self.shape)
        side = self.shape.samples
        if self.density.shape != (side, side, side):
            raise BadParameter(f"density is {self.density.shape}; {self.shape} wants {(side,) * 3}", shape=self.shape)
        if self.density.dtype != np.float32:
            raise BadParameter(f"density is {self.density.dtype}; it must be float32", dtype=str(self.density.dtype))
        if not self.density.flags.c_contiguous:
            raise BadParameter("density is not in C order", strides=self.density.strides)
