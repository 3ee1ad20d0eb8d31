"""The native chunk format, version 1, from bytes to arrays: docs/wire/native-v1.md.

header, 96 bytes | block table, 16 bytes a block | positions | normals | indices
"""

import math
import struct
from typing import Any, Final, NamedTuple

from numpy.typing import NDArray

from chunkserver_client.errors import BadChunk
from chunkserver_client.mesh import (
    COARSER_MAX,
    CONTENTS,
    INDICES_MAX,
    POSITION_LOW,
    POSITION_MAX,
    REVISION_MAX,
    VERTICES_MAX,
    ChunkKey,
    ChunkMesh,
    Place,
    Profile,
    Triple,
    check_bounds,
    check_triangles,
    empty_mesh,
    view,
)

MAGIC: Final = b"CHNK"
VERSION: Final = 1
HEADER_BYTES_MIN: Final = 96
ALIGNMENT: Final = 16
PROFILES: Final[tuple[Profile, ...]] = ("std", "f32")
POSITIONS, NORMALS, INDICES = 1, 2, 3
I8, U16, U32, F32 = 5120, 5123, 5125, 5126
NORMAL_MAX: Final = 1.001
"""Of a component in float32: a unit vector's, and more than any rounding."""
NOT_STATED: Final = -1.0

_HEADER: Final = struct.Struct("<4s2H 3q Q d 2I f H 6B I 3H 3H")
_BLOCK: Final = struct.Struct("<4H 2I")
assert _HEADER.size == HEADER_BYTES_MIN - 12, "twelve reserved bytes follow"


class _Header(NamedTuple):
    magic: bytes
    version: int
    header_bytes: int
    x: int
    y: int
    z: int
    revision: int
    voxel_size: float
    vertex_count: int
    index_count: int
    geometric_error: float
    cells: int
    lod: int
    profile: int
    coarser: int
    content: int
    index_bytes: int
    block_count: int
    file_bytes: int
    low: Triple
    high: Triple


class _Kind(NamedTuple):
    """What a block of one kind has to be."""

    component_type: int
    dtype: str
    components: int
    stride: int


_U16: Final = _Kind(U16, "<u2", 1, 2)
_U32: Final = _Kind(U32, "<u4", 1, 4)
_KINDS: Final[dict[tuple[Profile, int], dict[int, _Kind]]] = {
    ("std", 2): {POSITIONS: _Kind(U16, "<u2", 4, 8), NORMALS: _Kind(I8, "<i1", 4, 4), INDICES: _U16},
    ("std", 4): {POSITIONS: _Kind(U16, "<u2", 4, 8), NORMALS: _Kind(I8, "<i1", 4, 4), INDICES: _U32},
    ("f32", 4): {POSITIONS: _Kind(F32, "<f4", 3, 12), NORMALS: _Kind(F32, "<f4", 3, 12), INDICES: _U32},
}


def decode_native(content: memoryview) -> ChunkMesh:
    """Return the mesh in `content`, a whole file. Raises `BadChunk`, whatever the bytes are; nothing else."""
    header = _read_header(content)
    place = Place(ChunkKey(header.lod, header.x, header.y, header.z), header.cells, header.voxel_size).check()
    what = CONTENTS[header.content]
    geometric_error = None if header.geometric_error == NOT_STATED else header.geometric_error
    if what != "surface":
        if header.vertex_count or header.index_count or header.block_count:
            raise BadChunk(f"content is {what}, but there are {header.vertex_count} vertices")
        return empty_mesh(place, what, header.revision, header.coarser, geometric_error)
    profile = PROFILES[header.profile]
    positions, normals, indices = _read_blocks(content, header, profile)
    if profile == "f32":
        _check_floats(positions, -POSITION_LOW * place.unit, (POSITION_MAX - POSITION_LOW) * place.unit, "position")
        _check_floats(normals, -NORMAL_MAX, NORMAL_MAX, "normal")
    check_triangles(indices, header.vertex_count)
    return ChunkMesh(
        key=place.key,
        cells=place.cells,
        voxel_size=place.voxel_size,
        content=what,
        revision=header.revision,
        coarser=header.coarser,
        geometric_error=geometric_error,
        profile=profile,
        low=header.low,
        high=header.high,
        positions=positions[:, :3],
        normals=normals[:, :3],
        triangles=indices.reshape(-1, 3),
    )


def _read_header(content: memoryview) -> _Header:
    if len(content) < HEADER_BYTES_MIN:
        raise BadChunk(f"{len(content)} bytes: a header has {HEADER_BYTES_MIN}")
    *fields, a, b, c, d, e, f = _HEADER.unpack_from(content)
    header = _Header._make((*fields, (a, b, c), (d, e, f)))
    if header.magic != MAGIC or header.version != VERSION:
        raise BadChunk(f"begins with {header.magic!r} {header.version}: expected {MAGIC!r} {VERSION}")
    if header.file_bytes != len(content):
        raise BadChunk(f"file_bytes is {header.file_bytes}: there are {len(content)}")
    for name, highest in _HIGHEST.items():
        if (value := getattr(header, name)) > highest:
            raise BadChunk(f"{name} is {value}: at most {highest}")
    if header.index_count % 3:
        raise BadChunk(f"index_count is {header.index_count}: three a triangle")
    stated = header.geometric_error
    if stated != NOT_STATED and not (math.isfinite(stated) and stated >= 0):
        raise BadChunk(f"geometric_error is {stated}: metres, or -1 where it is not stated")
    check_bounds(header.low, header.high)
    return header


_HIGHEST: Final = {
    "revision": REVISION_MAX,
    "vertex_count": VERTICES_MAX,
    "index_count": INDICES_MAX,
    "profile": len(PROFILES) - 1,
    "coarser": COARSER_MAX,
    "content": len(CONTENTS) - 1,
}


def _read_blocks(content: memoryview, header: _Header, profile: Profile) -> list[NDArray[Any]]:
    """Return positions, normals and indices, as they stand in the file: (count, components)."""
    kinds = _KINDS.get((profile, header.index_bytes))
    if kinds is None:
        raise BadChunk(f"index_bytes is {header.index_bytes} in profile {profile}")
    end = header.header_bytes + _BLOCK.size * header.block_count
    if header.header_bytes < HEADER_BYTES_MIN or end > len(content):
        raise BadChunk(f"a table of {header.block_count} blocks at {header.header_bytes}: beyond the file")
    counts = {POSITIONS: header.vertex_count, NORMALS: header.vertex_count, INDICES: header.index_count}
    found: dict[int, NDArray[Any]] = {}
    for row in range(header.block_count):
        kind, *entry, offset, byte_length = _BLOCK.unpack_from(content, header.header_bytes + _BLOCK.size * row)
        if kind not in kinds:
            continue  # a later writer's
        wanted = kinds[kind]
        if entry != [wanted.component_type, wanted.components, wanted.stride] or kind in found:
            raise BadChunk(f"block {row} of kind {kind} has type, components, stride {entry}: expected {wanted}")
        if offset % ALIGNMENT or offset < end or byte_length != counts[kind] * wanted.stride:
            raise BadChunk(f"block {row} of kind {kind} has {byte_length} bytes at {offset}")
        found[kind] = view(content, wanted.dtype, counts[kind], wanted.components, offset, wanted.stride)
    missing = kinds.keys() - found
    if missing:
        raise BadChunk(f"no block of kind {sorted(missing)}")
    return [found[kind] for kind in (POSITIONS, NORMALS, INDICES)]


def _check_floats(values: NDArray[Any], low: float, high: float, what: str) -> None:
    """Raise `BadChunk` for a number outside, or for one that is none: every comparison with NaN is false."""
    if values.size and not (values.min() >= low and values.max() <= high):
        raise BadChunk(f"a {what} is no number from {low} to {high}")
