"""GLB, from bytes to arrays: docs/wire/glb.md. Reads what chunkserver writes, not every glTF.

12 bytes | JSON chunk | BIN chunk: positions | normals | indices
"""

import struct
from typing import Any, Final

from numpy.typing import NDArray

from chunkserver_client.errors import BadChunk
from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import (
    COARSER_MAX,
    CONTENTS,
    INDICES_MAX,
    POSITION_MAX,
    REVISION_MAX,
    VERTICES_MAX,
    VOXELS_MAX,
    ChunkKey,
    ChunkMesh,
    Content,
    Place,
    Triple,
    check_bounds,
    check_triangles,
    empty_mesh,
    view,
)

MAGIC: Final = b"glTF"
VERSION: Final = 2
JSON_BYTES_MAX: Final = 1 << 16
QUANTIZATION: Final = "KHR_mesh_quantization"
TRIANGLES: Final = 4
ACCESSORS_MAX: Final = 1 << 10
"""Of accessors and of views of the buffer: three, in what chunkserver writes."""
STRIDE_MAX: Final = 252
OFFSET_MAX: Final = (1 << 32) - 1
I8, U16, U32 = 5120, 5123, 5125

_CONTAINER: Final = struct.Struct("<4s2I")
_CHUNK: Final = struct.Struct("<I4s")
_DTYPES: Final = {I8: ("<i1", 1), U16: ("<u2", 2), U32: ("<u4", 4)}
_COMPONENTS: Final = {"SCALAR": 1, "VEC3": 3}


def decode_glb(content: memoryview) -> ChunkMesh:
    """Return the mesh in `content`, a whole file. Raises `BadChunk`, whatever the bytes are; nothing else.

    The place is that of the node's extras, which is exact; the node's own numbers have to agree with it.
    """
    text, binary = _split(content)
    scene = Json.parse(text, BadChunk)
    node = scene["nodes"][0]
    extras = node["extras"]
    place = _place(extras)
    _check_transform(node, place)
    revision = extras["revision"].decimal(0, REVISION_MAX)
    coarser = extras["coarser"].integer(0, COARSER_MAX)
    what: Content = extras["content"].one_of(*CONTENTS)
    if (what == "surface") != (node.get("mesh") is not None):
        raise BadChunk(f"content is {what}, and there is {'no' if what == 'surface' else 'a'} mesh")
    if what != "surface":
        return empty_mesh(place, what, revision, coarser)
    extensions = [extension.text() for extension in scene["extensionsRequired"]]
    if extensions != [QUANTIZATION]:
        raise BadChunk(f"needs the extensions {extensions}: known is {QUANTIZATION}")
    return _mesh(scene, node["mesh"].integer(0, 0), binary, place=place, revision=revision, coarser=coarser)


def _split(content: memoryview) -> tuple[bytes, memoryview]:
    """Return the JSON text and the BIN chunk, which is empty if there is none."""
    if len(content) < _CONTAINER.size + _CHUNK.size:
        raise BadChunk(f"{len(content)} bytes: a GLB has more")
    magic, version, length = _CONTAINER.unpack_from(content)
    if (magic, version) != (MAGIC, VERSION):
        raise BadChunk(f"begins with {magic!r} {version}: expected {MAGIC!r} {VERSION}")
    if length != len(content):
        raise BadChunk(f"its length is {length}: there are {len(content)} bytes")
    text, end = _chunk(content, _CONTAINER.size, b"JSON")
    if len(text) > JSON_BYTES_MAX:
        raise BadChunk(f"{len(text)} bytes of JSON: at most {JSON_BYTES_MAX}")
    if end == len(content):
        return bytes(text), memoryview(b"")
    binary, end = _chunk(content, end, b"BIN\0")
    if end != len(content):
        raise BadChunk(f"{len(content) - end} bytes behind the BIN chunk")
    return bytes(text), binary


def _chunk(content: memoryview, start: int, wanted: bytes) -> tuple[memoryview, int]:
    begin = start + _CHUNK.size
    if begin > len(content):
        raise BadChunk(f"no header of a chunk at {start}")
    length, kind = _CHUNK.unpack_from(content, start)
    if kind != wanted or begin + length > len(content):
        raise BadChunk(f"a chunk {kind!r} of {length} bytes at {start}: expected {wanted!r} and no more than there is")
    return content[begin : begin + length], begin + length


def _place(extras: Json) -> Place:
    lod, *xyz = (extras[name].decimal(-VOXELS_MAX, VOXELS_MAX) for name in ("lod", "x", "y", "z"))
    return Place(ChunkKey(lod, *xyz), extras["cells"].integer(0, VOXELS_MAX), extras["voxel_size"].number()).check()


def _check_transform(node: Json, place: Place) -> None:
    """Raise `BadChunk` if the node puts the chunk somewhere else: frame `world` or `chunk`, see the page."""
    margin = place.side // 2
    world = [place.voxel_size * (low - margin) for low in place.corner]
    chunk = [-place.voxel_size * margin] * 3
    translation = [element.number() for element in node["translation"]]
    if translation not in (world, chunk):
        node["translation"].refuse(f"{world} or {chunk}")
    if [element.number() for element in node["scale"]] != [place.unit] * 3:
        node["scale"].refuse(f"three times {place.unit}")


def _mesh(scene: Json, mesh: int, binary: memoryview, *, place: Place, revision: int, coarser: int) -> ChunkMesh:
    primitive = scene["meshes"][mesh]["primitives"][0]
    mode = primitive.get("mode")
    if mode is not None:
        mode.integer(TRIANGLES, TRIANGLES)
    attributes = primitive["attributes"]
    position = _accessor(scene, attributes["POSITION"], normalized=False)
    positions = _array(scene, position, binary, (U16,), "VEC3")
    normals = _array(scene, _accessor(scene, attributes["NORMAL"], normalized=True), binary, (I8,), "VEC3")
    indices = _array(scene, _accessor(scene, primitive["indices"], normalized=False), binary, (U16, U32), "SCALAR")
    low, high = _corner(position["min"]), _corner(position["max"])
    check_bounds(low, high)
    if len(normals) != len(positions) or len(indices) % 3:
        raise BadChunk(f"{len(positions)} positions, {len(normals)} normals, {len(indices)} indices")
    if not indices.flags.c_contiguous:
        raise BadChunk("the indices are not packed")
    check_triangles(indices, len(positions))
    return ChunkMesh(
        key=place.key,
        cells=place.cells,
        voxel_size=place.voxel_size,
        content="surface",
        revision=revision,
        coarser=coarser,
        low=low,
        high=high,
        positions=positions,
        normals=normals,
        triangles=indices.reshape(-1, 3),
    )


def _corner(values: Json) -> Triple:
    x, y, z = (values[axis].integer(0, POSITION_MAX) for axis in range(3))
    return x, y, z


def _accessor(scene: Json, number: Json, *, normalized: bool) -> Json:
    accessor = scene["accessors"][number.integer(0, ACCESSORS_MAX)]
    stated = accessor.get("normalized")
    if (stated is not None and stated.boolean()) != normalized:
        accessor["normalized"].refuse(str(normalized))
    if accessor.get("sparse") is not None:
        accessor["sparse"].refuse("nothing")
    return accessor


def _array(scene: Json, accessor: Json, binary: memoryview, types: tuple[int, ...], shape: str) -> NDArray[Any]:
    """Return (count, components), a view."""
    component_type = accessor["componentType"].integer(min(types), max(types))
    if component_type not in types or accessor["type"].text() != shape:
        accessor["type"].refuse(f"{shape} of one of {types}")
    dtype, size = _DTYPES[component_type]
    components = _COMPONENTS[shape]
    count = accessor["count"].integer(0, INDICES_MAX if shape == "SCALAR" else VERTICES_MAX)
    source = scene["bufferViews"][accessor["bufferView"].integer(0, ACCESSORS_MAX)]
    source["buffer"].integer(0, 0)
    start = _offset(source)
    byte_length = source["byteLength"].integer(0, len(binary))
    if start + byte_length > len(binary):
        source["byteLength"].refuse(f"at most {len(binary) - start}")
    stride = source.get("byteStride")
    return view(
        binary[start : start + byte_length],
        dtype,
        count,
        components,
        _offset(accessor),
        size * components if stride is None else stride.integer(size * components, STRIDE_MAX),
    )


def _offset(holder: Json) -> int:
    offset = holder.get("byteOffset")
    return 0 if offset is None else offset.integer(0, OFFSET_MAX)
