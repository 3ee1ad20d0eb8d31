"""What every format is told beside the mesh: how to write it, and where the chunk is."""

from typing import Final, NamedTuple

from chunkserver.errors import BadParameter
from chunkserver.grid import MASK_MAX, POSITION_HIGH, POSITION_LOW, ChunkKey, ChunkShape, check_key, check_shape
from chunkserver.mesh import NormalKind
from chunkserver.wire.coding import CODING_DEFAULT

VOXEL_SIZE_MIN: Final = 2.0**-20
"""Metres. Between the two limits every length in a file is 0 or a normal number, as float32 or as float64."""
VOXEL_SIZE_MAX: Final = 2.0**20
REVISION_MAX: Final = (1 << 63) - 1
"""Fits the native header's u64, and the signed 64 bits that most clients and stores have."""
GEOMETRIC_ERROR_NOT_STATED: Final = -1.0
GEOMETRIC_ERROR_MAX: Final = 2.0**60
"""Metres: as wide as a world of the largest voxels."""


class Encoding(NamedTuple):
    """How a mesh is written; `Encoding()` is the default. A field that does not apply to the format holds its own.

    format: a row of `FORMATS`.
    profile: "std" (lattice positions, normals as bytes), or "f32" (float32 metres and normals, 32-bit indices).
    frame: where a GLB's node puts the chunk: "world", or "chunk" (the origin is the chunk's low corner).
    coding: a row of `CODINGS`, applied to the finished file.
    """

    format: str = "mesh"
    profile: str = "std"
    frame: str = "world"
    coding: str = CODING_DEFAULT

    @property
    def normals(self) -> NormalKind:
        """The kind of normals that a mesh must have to be written so."""
        return "float32" if self.profile == "f32" else "int8"


class Placement(NamedTuple):
    """Where a chunk is, and which state of it.

    voxel_size: metres.
    revision: the chunk's own last edit, 0 for a pristine chunk.
    coarser: mask of the faces whose neighbour is one LOD coarser.
    geometric_error: metres by which the surface may be off; GEOMETRIC_ERROR_NOT_STATED, or 0 and more.
    """

    key: ChunkKey
    cells: int
    voxel_size: float
    revision: int = 0
    coarser: int = 0
    geometric_error: float = GEOMETRIC_ERROR_NOT_STATED

    @property
    def unit(self) -> float:
        """Metres per lattice unit. Exact: `voxel_size` times a power of two."""
        return self.voxel_size * (self.cells * self.key.step / (POSITION_HIGH - POSITION_LOW))

    @property
    def margin(self) -> int:
        """Voxels from the point that position (0, 0, 0) names to the chunk's low corner, on each axis."""
        return self.cells * self.key.step // 2


def check_placement(placement: Placement) -> None:
    """Raise `BadKey` or `BadParameter` that names the value, unless every format can hold `placement`."""
    key, cells, voxel_size, revision, coarser, error = placement
    check_shape(ChunkShape(cells))
    check_key(key, cells, coarser=coarser)
    if not VOXEL_SIZE_MIN <= voxel_size <= VOXEL_SIZE_MAX:
        limits = f"[{VOXEL_SIZE_MIN}, {VOXEL_SIZE_MAX}]"
        raise BadParameter(f"voxel_size is {voxel_size}; it lies in {limits} metres", voxel_size=voxel_size)
    if not 0 <= revision <= REVISION_MAX:
        raise BadParameter(f"revision is {revision}; it lies in [0, {REVISION_MAX}]", revision=revision)
    if not 0 <= coarser <= MASK_MAX:
        raise BadParameter(f"coarser is {coarser}; it lies in [0, {MASK_MAX}]", coarser=coarser)
    if not (error == GEOMETRIC_ERROR_NOT_STATED or 0 <= error <= GEOMETRIC_ERROR_MAX):
        limits = f"[0, {GEOMETRIC_ERROR_MAX:g}] metres, or is {GEOMETRIC_ERROR_NOT_STATED} if not stated"
        raise BadParameter(f"geometric_error is {error}; it lies in {limits}", geometric_error=error)
