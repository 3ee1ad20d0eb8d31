"""Chunks of several levels side by side: random balanced octrees, and fields of our own for their levels."""

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import FACES, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh, NormalKind
from chunkserver.mesher import extract
from chunkserver.samples import Samples, coarse_box
from tests.worlds import Densities

Points = NDArray[np.int64]
Field = Callable[[int, Points, Points, Points], Densities]
"""(level, x, y, z) -> densities there; x, y, z: lattice points, voxels."""

_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


class Octree:
    """The leaves of an octree over 2 x 2 x 2 chunks of level `top`; neighbours differ by a level at most.

    low: the chunk of that level that is the first.
    """

    def __init__(self, top: int, low: tuple[int, int, int] = (0, 0, 0)) -> None:
        self.top = top
        self.leaves = {ChunkKey(top, *place) for place in product(*(range(first, first + 2) for first in low))}

    def leaf(self, key: ChunkKey) -> ChunkKey | None:
        """Return the leaf that `key` is, or lies in; None if it is outside, or was split."""
        for lod in range(key.lod, self.top + 1):
            found = ChunkKey(lod, *(place >> lod - key.lod for place in key[1:]))
            if found in self.leaves:
                return found
        return None

    def split(self, key: ChunkKey) -> None:
        """Replace a leaf by its eight children; first whatever beside it is coarser than that allows."""
        for step in product((-1, 0, 1), repeat=3):
            beside = ChunkKey(key.lod, *(place + there for place, there in zip(key[1:], step, strict=True)))
            while (found := self.leaf(beside)) is not None and found.lod > key.lod:
                self.split(found)
        self.leaves.remove(key)
        for half in product(range(2), repeat=3):
            self.leaves.add(
                ChunkKey(key.lod - 1, *(2 * place + side for place, side in zip(key[1:], half, strict=True)))
            )

    def coarser(self, key: ChunkKey) -> int:
        """Return the mask of the faces of a leaf behind which there is a coarser one."""
        mask = 0
        for face in range(FACES):
            place = list(key[1:])
            place[face // 2] += 1 if face & 1 else -1
            found = self.leaf(ChunkKey(key.lod, *place))
            mask |= (found is not None and found.lod > key.lod) << face
        return mask


def random_octree(
    rng: np.random.Generator, levels: int, share: float, low: tuple[int, int, int] = (0, 0, 0), finest: int = 0
) -> Octree:
    """Return an octree of so many levels at most, in which `share` of the leaves of each level were split."""
    tree = Octree(finest + levels - 1, low)
    for lod in range(finest + levels - 1, finest, -1):
        for key in sorted(key for key in tree.leaves if key.lod == lod):
            if key in tree.leaves and rng.random() < share:
                tree.split(key)
    return tree


def deep_octree(rng: np.random.Generator, levels: int) -> Octree:
    """Return a small octree of exactly so many levels: of each but the finest, a random leaf was split."""
    tree = Octree(levels - 1)
    for lod in range(levels - 1, 0, -1):
        leaves = sorted(key for key in tree.leaves if key.lod == lod)
        tree.split(leaves[rng.integers(len(leaves))])
    return tree


def chunks_of(
    tree: Octree, field: Field, cells: int, masked: bool = True, normals: NormalKind = "int8"
) -> Iterator[tuple[ChunkKey, Mesh]]:
    """Yield the chunks of all leaves. masked: closed against coarser neighbours."""
    for key in sorted(tree.leaves):
        samples = samples_of(field, key, ChunkShape(cells), tree.coarser(key) if masked else 0)
        yield key, extract(samples, normals=normals)


def samples_of(field: Field, key: ChunkKey, shape: ChunkShape, coarser: int) -> Samples:
    """Return the samples of a chunk."""
    low = np.array(key.low_corner(shape.cells))
    density = _sampled(field, key.lod, low - shape.apron * key.step, (shape.samples,) * 3)
    if not coarser:
        return Samples(shape, density)
    box = coarse_box(shape.cells, coarser)
    return Samples(
        shape, density, coarser, _sampled(field, key.lod + 1, low + 2 * key.step * np.array(box.low), box.shape)
    )


def _sampled(field: Field, lod: int, low: Points, shape: tuple[int, int, int]) -> Densities:
    y, z, x = np.meshgrid(
        *(low[axis] + (np.arange(n) << lod) for axis, n in zip((1, 2, 0), shape, strict=True)), indexing="ij"
    )
    return np.ascontiguousarray(np.broadcast_to(field(lod, x, y, z), shape), np.float32)


def _hashed(seed: int, level: int, x: Points, y: Points, z: Points) -> NDArray[np.uint64]:
    """Return 24 random bits for each point: always the same ones."""
    mixed = np.full(x.shape, seed * 64 + level, np.uint64)
    for axis, factor in zip((x, y, z), _MIX, strict=True):
        mixed = (mixed ^ axis.astype(np.uint64)) * factor
        mixed ^= mixed >> np.uint64(29)
    bits: NDArray[np.uint64] = (mixed * _MIX[0]) >> np.uint64(40)
    return bits


def noise_of_all(seed: int) -> Field:
    """Return white noise, the same at all levels: coarse corners equal fine samples."""
    return lambda _, x, y, z: (_hashed(seed, 0, x, y, z) / 2.0**23 - 1).astype(np.float32)


def noise_of_each(seed: int) -> Field:
    """Return white noise, another one at each level: whatever a level may fade, it is less."""
    return lambda level, x, y, z: (_hashed(seed, level + 1, x, y, z) / 2.0**23 - 1).astype(np.float32)


def integers(seed: int) -> Field:
    """Return -1, 0 and 1, so that a third of all samples are exactly at the isovalue."""
    return lambda level, x, y, z: (_hashed(seed, level, x, y, z).astype(np.int64) % 3 - 1).astype(np.float32)


def planes(seed: int) -> Field:
    """Return a box whose faces lie in the lattice, some of them in borders of chunks."""
    low, high = np.sort(np.random.default_rng(seed).integers(0, 9, (2, 3)) * 8, axis=0)

    def field(_: int, x: Points, y: Points, z: Points) -> Densities:
        sides = [np.maximum(a - at, at - b - 8) for at, a, b in zip((x, y, z), low, high, strict=True)]
        return np.asarray(np.maximum.reduce(sides) - 4, np.float32)

    return field


def spheres(seed: int) -> Field:
    """Return a ball that each level sees a little smaller."""
    rng = np.random.default_rng(seed)
    middle, radius = rng.uniform(20, 44, 3), rng.uniform(8, 28)

    def field(level: int, x: Points, y: Points, z: Points) -> Densities:
        place = [axis - at for axis, at in zip((x, y, z), middle, strict=True)]
        distance = np.sqrt(np.sum([axis * axis for axis in place], axis=0)) - radius
        return np.asarray(distance + 0.7 * level, np.float32)

    return field


FIELDS: dict[str, Callable[[int], Field]] = {
    "the same noise": noise_of_all,
    "another noise": noise_of_each,
    "integers": integers,
    "planes": planes,
    "spheres": spheres,
}
