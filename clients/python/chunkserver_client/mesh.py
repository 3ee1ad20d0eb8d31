"""The mesh of one chunk, and where it is: in exact integers first, in metres when somebody asks.

A chunk's own lattice has 32768 units a side; its low face is at 16384. `lattice_positions` puts the vertices on one
lattice for the whole world, that of LOD 0, where the same point has the same integers whichever chunk, LOD or format it
came in.
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver_client.errors import BadChunk

Content = Literal["air", "rock", "surface"]
Profile = Literal["std", "f32"]
Triple = tuple[int, int, int]

CONTENTS: Final[tuple[Content, ...]] = ("air", "rock", "surface")
"""In the order of their numbers in files."""
UNITS_PER_SIDE: Final = 32768
"""Lattice units from a chunk's low face to its high face."""
POSITION_LOW: Final = 16384
"""Where the low face is on the chunk's own lattice."""
POSITION_MAX: Final = 65535
CELLS_BUILT: Final = (16, 32, 64)
LOD_MAX: Final = 20
COARSER_MAX: Final = 63
REVISION_MAX: Final = (1 << 63) - 1
VOXEL_SIZE_MIN: Final = 2.0**-20
VOXEL_SIZE_MAX: Final = 2.0**20
VOXELS_MAX: Final = 1 << 40
"""Corners of chunks lie within so many voxels of the origin, on each axis."""
VERTICES_MAX: Final = 1 << 24
INDICES_MAX: Final = 3 << 25

# The farthest vertex from the farthest origin: an int64 holds it, and a float64 without rounding.
assert 2 * (VOXELS_MAX // CELLS_BUILT[0] + 2 * (1 << LOD_MAX)) * UNITS_PER_SIDE < 1 << 53


class ChunkKey(NamedTuple):
    """Which chunk: its level of detail, 0 the finest, and its coordinates in chunks of that level."""

    lod: int
    x: int
    y: int
    z: int


class Place(NamedTuple):
    """Which chunk of which grid."""

    key: ChunkKey
    cells: int
    voxel_size: float

    @property
    def side(self) -> int:
        """Voxels along a side."""
        return self.cells << self.key.lod

    @property
    def unit(self) -> float:
        """Metres per unit of the chunk's own lattice: `voxel_size` times a power of two, so it is exact."""
        return self.voxel_size * self.side / UNITS_PER_SIDE

    @property
    def corner(self) -> Triple:
        """Voxels from the world's origin to the low corner."""
        return (self.key.x * self.side, self.key.y * self.side, self.key.z * self.side)

    def squared_distance(self, viewer: Sequence[float]) -> float:
        """Return the square of the distance from a point to the nearest of the chunk, in voxels."""
        gaps = (max(low - at, at - low - self.side, 0.0) for low, at in zip(self.corner, viewer, strict=True))
        return sum(gap * gap for gap in gaps)

    def check(self) -> "Place":
        """Return this. Raises `BadChunk`, which names the value, if there can be no such chunk."""
        if self.cells not in CELLS_BUILT:
            raise BadChunk(f"cells is {self.cells}: there are {CELLS_BUILT}")
        if not 0 <= self.key.lod <= LOD_MAX:
            raise BadChunk(f"lod is {self.key.lod}: there are 0 to {LOD_MAX}")
        if not VOXEL_SIZE_MIN <= self.voxel_size <= VOXEL_SIZE_MAX:
            raise BadChunk(f"voxel_size is {self.voxel_size}: it is 2^-20 to 2^20 metres")
        if not all(-VOXELS_MAX <= low <= VOXELS_MAX - self.side for low in self.corner):
            raise BadChunk(f"{self.key} lies more than {VOXELS_MAX} voxels from the origin")
        return self


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChunkMesh:
    """The mesh of one chunk. Its arrays are read-only views into the bytes that it was decoded from: nothing is copied.

    key: the chunk's coordinates.
    cells: cells a side: 16, 32 or 64.
    voxel_size: metres.
    revision: of the chunk's own last edit; 0 is pristine.
    content: "surface", or "air" or "rock" for an empty chunk, which has neither vertices nor triangles.
    coarser: mask of the faces that fit a neighbour one LOD coarser: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32.
    geometric_error: metres by which the surface may be off; None if the file does not say.
    profile: "std" or "f32": which types positions and normals have. A GLB is "std".
    low, high: bounds of the vertices on the chunk's own lattice, whatever the profile; zeros in an empty chunk.
    positions: (V, 3). "std": uint16, units of the chunk's own lattice. "f32": float32, metres from its low corner.
    normals: (V, 3) into the air. "std": int8, a component is 127 times that of the unit vector. "f32": float32.
    triangles: (T, 3) uint16 or uint32, counter-clockwise seen from the air. Every index is below V.

    Positions and normals have a stride that is larger than three components where the file pads them.
    """

    key: ChunkKey
    cells: int
    voxel_size: float
    content: Content
    revision: int = 0
    coarser: int = 0
    geometric_error: float | None = None
    profile: Profile = "std"
    low: Triple = (0, 0, 0)
    high: Triple = (0, 0, 0)
    positions: NDArray[Any]
    normals: NDArray[Any]
    triangles: NDArray[Any]

    @property
    def place(self) -> Place:
        """Which chunk of which grid."""
        return Place(self.key, self.cells, self.voxel_size)

    @property
    def is_empty(self) -> bool:
        """Whether it is all air or all rock."""
        return self.content != "surface"

    def chunk_positions(self) -> NDArray[np.int64]:
        """Return (V, 3) int64: the vertices on the chunk's own lattice, of either profile.

        A float of profile "f32" is one rounding away from a 17-bit integer times `unit`, so it is 2^-7 of a unit off at
        most, and the nearest integer is the one that was meant.
        """
        if self.profile == "std":
            return self.positions.astype(np.int64)
        return np.rint(self.positions / np.float64(self.place.unit)).astype(np.int64) + POSITION_LOW

    def lattice_positions(self) -> NDArray[np.int64]:
        """Return (V, 3) int64: the vertices on the world's lattice, 32768 / cells units a voxel. Exact.

        Equal points have equal integers, from whichever chunk and LOD of a world: weld by equality.
        """
        corner = np.array(self.key[1:], np.int64) * UNITS_PER_SIDE
        return (self.chunk_positions() + (corner - POSITION_LOW)) << self.key.lod

    def positions_in_metres(self, origin: Triple | NDArray[np.integer] = (0, 0, 0)) -> NDArray[np.float64]:
        """Return (V, 3) float64: metres from `origin`, an integer point in voxels that the caller chooses.

        The difference is taken in integers, and is exact in float64 as well; times `voxel_size` it is rounded once, or
        not at all if that is a power of two. So vertices that are equal stay equal, and for an origin nearby the
        numbers are small enough for float32. Raises `ValueError` if `origin` lies outside the world.
        """
        try:
            voxels = [operator.index(voxel) for voxel in origin]
        except TypeError:
            voxels = []
        if len(voxels) != 3 or not all(abs(voxel) <= VOXELS_MAX for voxel in voxels):
            raise ValueError(f"origin is {origin}: three integers, within {VOXELS_MAX} voxels of zero")
        start = np.array(voxels, np.int64) * (UNITS_PER_SIDE // self.cells)
        metres: NDArray[np.float64] = np.multiply(
            self.lattice_positions() - start, self.voxel_size * self.cells / UNITS_PER_SIDE, dtype=np.float64
        )
        return metres

    def unit_normals(self) -> NDArray[np.float32]:
        """Return (V, 3) float32: unit vectors into the air."""
        if self.profile == "f32":
            return np.array(self.normals, np.float32)
        normals = self.normals.astype(np.float32)
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        unit: NDArray[np.float32] = np.divide(normals, np.maximum(length, 1.0)[:, None], dtype=np.float32)
        return unit


_NONE: Final = b""


def empty_mesh(
    place: Place, content: Content, revision: int = 0, coarser: int = 0, geometric_error: float | None = None
) -> ChunkMesh:
    """Return the mesh of a chunk that is all air or all rock."""
    return ChunkMesh(
        key=place.key,
        cells=place.cells,
        voxel_size=place.voxel_size,
        content=content,
        revision=revision,
        coarser=coarser,
        geometric_error=geometric_error,
        positions=np.frombuffer(_NONE, "<u2").reshape(0, 3),
        normals=np.frombuffer(_NONE, "<i1").reshape(0, 3),
        triangles=np.frombuffer(_NONE, "<u2").reshape(0, 3),
    )


def view(content: memoryview, dtype: str, count: int, components: int, offset: int, stride: int) -> NDArray[Any]:
    """Return `count` elements as a (count, components) read-only view. Raises `BadChunk` if they are not all there."""
    kind = np.dtype(dtype)
    size = kind.itemsize * components
    if stride < size or offset < 0 or (count and offset + (count - 1) * stride + size > len(content)):
        raise BadChunk(f"{count} elements of {size} bytes, {stride} apart, at {offset}: beyond {len(content)} bytes")
    if not count:
        return np.frombuffer(_NONE, kind).reshape(0, components)
    array: NDArray[Any] = np.ndarray((count, components), kind, content, offset, (stride, kind.itemsize))
    array.flags.writeable = False
    return array


def check_bounds(low: Triple, high: Triple) -> None:
    """Raise `BadChunk` if the bounds are the wrong way round."""
    if any(least > most for least, most in zip(low, high, strict=True)):
        raise BadChunk(f"low is {low}, above high, {high}")


def check_triangles(triangles: NDArray[Any], vertices: int) -> None:
    """Raise `BadChunk` if an index names no vertex."""
    highest = int(triangles.max(initial=0))
    if triangles.size and highest >= vertices:
        raise BadChunk(f"an index is {highest}: there are {vertices} vertices")
