"""Where things are: chunk keys, chunk shapes, and the one lattice that all chunks sample.

The world is sampled on the integer lattice; one lattice step is one voxel. A chunk has `cells` cells a side at every
LOD and its step is `2**lod` voxels, so the eight chunks (2x+a, 2y+b, 2z+c) of LOD n-1 fill chunk (x, y, z) of LOD n.

One row of samples along an axis, `cells` = 4, `apron` = 1 (the guard ring that central differences need):

    sample index   0   1   2   3   4   5   6        samples = cells + 1 + 2 * apron
    cell units    -1   0   1   2   3   4   5        cell unit = sample index - apron
                   a   [   .   .   .   ]   a        corners = cells + 1, a = apron

Vertices live on a finer lattice inside the chunk: u16 units, the low chunk face at 16384, the high face at 49152, so
that a margin of cells/2 cells on both sides can hold skirts (see `mesh.py`).
"""

from collections.abc import Set
from typing import Final, NamedTuple

from chunkserver.errors import BadKey, BadParameter

LOD_MAX: Final = 20
LATTICE_MAX: Final = 1 << 40
"""Largest |lattice coordinate| of a chunk's corner, in voxels. Exact in float64 with 12 bits to spare."""

CELLS_BUILT: Final = (16, 32, 64)
CELLS_DEFAULT: Final = 32
APRON_DEFAULT: Final = 1

FACES: Final = 6
"""Of a chunk, and bits of a mask of them: -x +x -y +y -z +z."""
MASK_MAX: Final = (1 << FACES) - 1
"""All faces of a chunk."""

POSITION_LOW: Final = 16384
"""Position, in lattice units, of a chunk's low face."""
POSITION_HIGH: Final = 49152
"""Position, in lattice units, of a chunk's high face."""

assert POSITION_HIGH - POSITION_LOW == 32768, "a chunk is 2**15 units wide: every unit is a power of two of a cell"
assert all(32768 % cells == 0 and 32768 // cells * cells // 2 == POSITION_LOW for cells in CELLS_BUILT)
assert LATTICE_MAX + (1 << LOD_MAX) * (max(CELLS_BUILT) + 1) < 1 << 53, "samples of an apron stay exact in float64"


class ChunkShape(NamedTuple):
    """How many cells a side a chunk has, and how many samples around its corners."""

    cells: int = CELLS_DEFAULT
    apron: int = APRON_DEFAULT

    @property
    def corners(self) -> int:
        """Corners a side."""
        return self.cells + 1

    @property
    def samples(self) -> int:
        """Samples a side, apron included."""
        return self.cells + 1 + 2 * self.apron

    @property
    def units_per_cell(self) -> int:
        """Lattice units (of vertex positions) per cell: 1024 for 32 cells."""
        return (POSITION_HIGH - POSITION_LOW) // self.cells


def check_shape(shape: ChunkShape) -> None:
    """Raise `BadParameter` unless chunks of this shape are built."""
    if shape.cells not in CELLS_BUILT:
        raise BadParameter(f"cells is {shape.cells}; built are {CELLS_BUILT}", cells=shape.cells)
    if shape.apron < APRON_DEFAULT:
        raise BadParameter(f"apron is {shape.apron}; normals need at least {APRON_DEFAULT}", apron=shape.apron)


class ChunkKey(NamedTuple):
    """Which chunk: level of detail (0 is finest) and signed chunk coordinates at that level."""

    lod: int
    x: int
    y: int
    z: int

    @property
    def step(self) -> int:
        """Voxels between two neighbouring samples."""
        return 1 << self.lod

    def low_corner(self, cells: int) -> tuple[int, int, int]:
        """Lattice coordinates (x, y, z), in voxels, of the chunk's low corner. Exact integers."""
        side = cells << self.lod
        return self.x * side, self.y * side, self.z * side


def coarser_mask(key: ChunkKey, leaves: Set[ChunkKey]) -> int:
    """Return which faces of a chunk have a coarser one of `leaves` behind them: bits -x +x -y +y -z +z."""
    mask = 0
    for face in range(FACES):
        place = list(key[1:])
        place[face // 2] += 1 if face & 1 else -1
        mask |= (ChunkKey(key.lod + 1, *(at >> 1 for at in place)) in leaves) << face
    return mask


def check_key(key: ChunkKey, cells: int, lods: int = LOD_MAX + 1, coarser: int = 0) -> None:
    """Raise `BadKey` unless the chunk lies in the world: its LOD is one of `lods`, its corners within LATTICE_MAX.

    coarser: mask of the faces whose neighbour is one LOD coarser. Raises `BadParameter` if there is no such LOD.
    """
    lod, x, y, z = key
    if not 0 <= lod < lods:
        raise BadKey(f"lod is {lod}; this world has 0 to {lods - 1}", lod=lod)
    limit = LATTICE_MAX // (cells << lod)
    if not (-limit <= x < limit and -limit <= y < limit and -limit <= z < limit):
        axis, place = next((axis, at) for axis, at in zip("xyz", (x, y, z), strict=True) if not -limit <= at < limit)
        raise BadKey(f"{axis} is {place}; at lod {lod} it lies in [{-limit}, {limit})", **{axis: place})
    if coarser and lod == lods - 1:
        raise BadParameter(f"coarser is {coarser}; nothing is coarser than lod {lod} in this world", coarser=coarser)
