"""GLB, read back: docs/wire/glb.md from the reader's side.

The container is read byte by byte. Of the JSON only the place, the counts and the content are taken; what else should
stand in it is then written anew by the writer, and compared: a difference is named by its path.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadRequest
from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Content, Mesh, index_type
from chunkserver.wire import gltf
from chunkserver.wire.buffers import TRIANGLES_MAX, VERTICES_MAX
from chunkserver.wire.encoding import GEOMETRIC_ERROR_NOT_STATED, Placement, check_placement
from chunkserver.wire.reading.findings import (
    Fault,
    Findings,
    Geometry,
    bounds_of,
    geometry_faults,
    padding_faults,
    shown,
)

JSON_BYTES_MAX: Final = 1 << 16
"""The writer's has about 1,500. Anything in it that is long or deep is refused before it is looked into."""
DEPTH_MAX: Final = 16
"""Levels of the JSON. The writer's has 8: from here on nothing that walks it can exhaust the stack."""
DECIMAL: Final = re.compile("0|-?[1-9][0-9]{0,18}")
VERTEX_BYTES: Final = 12
POSITION_STRIDE: Final = 8
NORMAL_STRIDE: Final = 4
EXTRAS: Final = "$.nodes[0].extras"

_MISSING: Final = object()


class _Broken(Exception):
    """The file cannot be read any further. `args` are those of a `Fault`."""


class _Parts(NamedTuple):
    """scene: the JSON. binary: what stands in the BIN chunk, and at which byte of the file; empty without one."""

    scene: Any
    binary: memoryview
    at: int


def examine(file: bytes) -> Findings:
    """Return what is in `file`, and what is wrong with it. Never raises for what is in it."""
    facts: dict[str, Any] = {"format": "glb", "bytes": len(file)}
    faults: list[Fault] = []
    try:
        parts = _container(memoryview(file))
        placement, content = _place(parts.scene)
        facts |= _place_facts(placement, content, parts)
        mesh = EMPTY[content] if content != "surface" else _mesh(parts)
        facts |= _mesh_facts(mesh, placement, parts.at)
        faults += _scene_faults(mesh, placement, facts["frame"], parts)
        faults += _mesh_faults(mesh, parts)
    except _Broken as broken:
        faults.append(Fault(*broken.args))
    return Findings(facts, faults)


def _container(file: memoryview) -> _Parts:
    """Return the parts of a GLB. Raises `_Broken`."""
    header = gltf.CONTAINER.size
    if len(file) < header:
        raise _Broken(f"byte {len(file)}", f"the file ends after {len(file)} bytes; a header has {header}")
    magic, version, length = gltf.CONTAINER.unpack_from(file)
    if (magic, version) != (gltf.MAGIC, gltf.VERSION):
        raise _Broken("byte 0", f"magic and version are {magic!r}, {version}; wanted are {gltf.MAGIC!r}, 2")
    if length != len(file):
        raise _Broken("byte 8", f"the length is {length}; the file has {len(file)} bytes")
    text, end = _chunk(file, header, b"JSON")
    scene = _json(bytes(text))
    if end == len(file):
        return _Parts(scene, memoryview(b""), end)
    binary, after = _chunk(file, end, b"BIN\0")
    if after != len(file):
        raise _Broken(f"byte {after}", f"{len(file) - after} bytes follow the BIN chunk")
    return _Parts(scene, binary, end + gltf.CHUNK.size)


def _chunk(file: memoryview, at: int, wanted: bytes) -> tuple[memoryview, int]:
    """Return what stands in the chunk at byte `at`, and where it ends. Raises `_Broken`."""
    begin = at + gltf.CHUNK.size
    if begin > len(file):
        raise _Broken(f"byte {len(file)}", f"the file ends within the header of its {wanted!r} chunk")
    length, kind = gltf.CHUNK.unpack_from(file, at)
    if kind != wanted:
        raise _Broken(f"byte {at + 4}", f"the chunk is {kind!r}; wanted is {wanted!r}")
    if length % gltf.ALIGNMENT or begin + length > len(file):
        room = f"a multiple of {gltf.ALIGNMENT}, at most {len(file) - begin}"
        raise _Broken(f"byte {at}", f"the length of the {wanted!r} chunk is {length}; wanted is {room}")
    return file[begin : begin + length], begin + length


def _json(text: bytes) -> Any:
    if len(text) > JSON_BYTES_MAX:
        raise _Broken("byte 12", f"the JSON has {len(text)} bytes; a chunk has less than {JSON_BYTES_MAX}")
    try:
        scene = json.loads(text, parse_constant=_no_constant)
    except RecursionError:
        raise _too_deep() from None
    except ValueError as error:
        raise _Broken("$", f"is no JSON: {error!s:.100}") from None
    level = [scene]
    for _ in range(DEPTH_MAX):
        level = [below for value in level for below in _children(value)]
        if not level:
            return scene
    raise _too_deep()


def _children(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _too_deep() -> _Broken:
    return _Broken("$", f"is nested deeper than {DEPTH_MAX} levels")


def _no_constant(name: str) -> object:
    raise ValueError(f"{name} is no number")


def _find(scene: Any, path: str) -> Any:
    """Return what stands at a path such as `$.nodes[0].extras`; `_MISSING`, if nothing does."""
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        try:
            scene = scene[name or int(index)]
        except (KeyError, IndexError, TypeError):
            return _MISSING
    return scene


def _wanted(scene: Any, path: str, right: Callable[[Any], bool], what: str) -> Any:
    """Return what stands at `path`. Raises `_Broken` if `right` is not true of it."""
    found = _find(scene, path)
    if not right(found):
        raise _Broken(path, f"{_told(found)}; wanted is {what}")
    return found


def _told(found: object) -> str:
    return "is not there" if found is _MISSING else f"is {shown(found)}"


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, float) or _is_integer(value)


def _is_decimal(value: object) -> bool:
    return isinstance(value, str) and DECIMAL.fullmatch(value) is not None


def _place(scene: Any) -> tuple[Placement, Content]:
    """Return where the chunk is, by its node's extras. Raises `_Broken`."""
    _wanted(scene, EXTRAS, lambda value: isinstance(value, dict), "what makes a GLB a chunk: its key, cells and place")
    lod, x, y, z, revision = (
        int(_wanted(scene, f"{EXTRAS}.{name}", _is_decimal, "a decimal integer, as a string"))
        for name in ("lod", "x", "y", "z", "revision")
    )
    cells, coarser = (_wanted(scene, f"{EXTRAS}.{name}", _is_integer, "an integer") for name in ("cells", "coarser"))
    voxel_size = _wanted(scene, f"{EXTRAS}.voxel_size", _is_number, "a number")
    contents = get_args(Content)
    content = _wanted(
        scene, f"{EXTRAS}.content", lambda value: isinstance(value, str) and value in contents, f"one of {contents}"
    )
    error = _find(scene, f"{EXTRAS}.geometric_error")
    if error is _MISSING:
        error = GEOMETRIC_ERROR_NOT_STATED
    elif not _is_number(error) or error < 0:
        raise _Broken(f"{EXTRAS}.geometric_error", f"{_told(error)}; wanted is a number, 0 or more")
    placement = Placement(ChunkKey(lod, x, y, z), cells, voxel_size, revision, coarser, error)
    try:
        check_placement(placement)
    except BadRequest as error:
        raise _Broken(f"{EXTRAS}.{next(iter(error.values))}", error.message) from None
    return placement, content


def _place_facts(placement: Placement, content: Content, parts: _Parts) -> dict[str, Any]:
    key, cells, voxel_size, revision, coarser, error = placement
    in_chunk = gltf.scene_of(EMPTY["air"], placement, "chunk", [])["nodes"][0]["translation"]
    in_world = gltf.scene_of(EMPTY["air"], placement, "world", [])["nodes"][0]["translation"]
    found = _find(parts.scene, "$.nodes[0].translation")
    used = _find(parts.scene, "$.extensionsUsed")
    return {
        "key": key._asdict(),
        "cells": cells,
        "voxel_size": float(voxel_size),
        "revision": str(revision),
        "coarser": coarser,
        "content": content,
        "profile": "std",
        "geometric_error": None if error == GEOMETRIC_ERROR_NOT_STATED else float(error),
        "frame": "chunk" if found == in_chunk != in_world else "world",
        "extensions": [name for name in used if isinstance(name, str)] if isinstance(used, list) else [],
    }


def _mesh(parts: _Parts) -> Mesh:
    """Return what stands in the BIN chunk, as the writer lays it out. Raises `_Broken` if it is too short for that."""
    vertices = _count(parts.scene, 0, VERTICES_MAX)
    count = _count(parts.scene, 2, 3 * TRIANGLES_MAX)
    if count % 3:
        raise _Broken("$.accessors[2].count", f"is {count}; wanted is a multiple of 3")
    narrow = np.dtype(index_type(vertices))
    used = VERTEX_BYTES * vertices + narrow.itemsize * count
    if used > len(parts.binary):
        raise _Broken(f"byte {parts.at}", f"the BIN chunk has {len(parts.binary)} bytes; the accessors need {used}")
    indices = np.frombuffer(parts.binary, narrow, count, VERTEX_BYTES * vertices)
    return Mesh(
        "surface",
        np.frombuffer(parts.binary, "<u2", 4 * vertices).reshape(-1, 4),
        np.frombuffer(parts.binary, np.int8, 4 * vertices, POSITION_STRIDE * vertices).reshape(-1, 4),
        indices.reshape(-1, 3),
    )


def _count(scene: Any, accessor: int, count_max: int) -> int:
    path, wanted = f"$.accessors[{accessor}].count", f"1 to {count_max}"
    found: int = _wanted(scene, path, lambda value: _is_integer(value) and 0 < value <= count_max, wanted)
    return found


def _mesh_facts(mesh: Mesh, placement: Placement, at: int) -> dict[str, Any]:
    """at: where in the file the views begin."""
    facts: dict[str, Any] = {"vertices": len(mesh.positions), "triangles": len(mesh.triangles), "bounds": None}
    if mesh.is_empty:
        return {**facts, "blocks": []}
    scene = gltf.scene_of(mesh, placement, "world", _buffers(mesh))
    low, high = (scene["accessors"][0][name] for name in ("min", "max"))
    facts["bounds"] = bounds_of(placement, low, high)
    facts["blocks"] = [
        {
            "name": name,
            "type": buffer.dtype.name,
            "components": buffer.shape[1] if name != "indices" else 1,
            "stride": view.get("byteStride", buffer.itemsize),
            "offset": at + view["byteOffset"],
            "bytes": view["byteLength"],
        }
        for name, buffer, view in zip(
            ("positions", "normals", "indices"), _buffers(mesh), scene["bufferViews"], strict=True
        )
    ]
    return facts


def _buffers(mesh: Mesh) -> list[NDArray[Any]]:
    return [] if mesh.is_empty else [mesh.positions, mesh.normals, mesh.triangles]


def _scene_faults(mesh: Mesh, placement: Placement, frame: str, parts: _Parts) -> Iterator[Fault]:
    expected = gltf.scene_of(mesh, placement, frame, _buffers(mesh))
    del expected["asset"]["generator"]
    yield from _differences(expected, parts.scene, "$")
    if mesh.is_empty and (len(parts.binary) or _find(parts.scene, "$.nodes[0].mesh") is not _MISSING):
        yield Fault("$.nodes[0]", "an empty chunk has neither a mesh nor a BIN chunk")


def _differences(expected: Any, found: Any, path: str) -> Iterator[Fault]:
    """Yield where `found` lacks what is expected, or has something else. It may have more members."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name, value in expected.items():
            yield from _differences(value, found.get(name, _MISSING), f"{path}.{name}")
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for index, (value, other) in enumerate(zip(expected, found, strict=True)):
            yield from _differences(value, other, f"{path}[{index}]")
    elif expected != found or isinstance(expected, bool) is not isinstance(found, bool):
        yield Fault(path, f"{_told(found)}; wanted is {shown(expected)}")


def _mesh_faults(mesh: Mesh, parts: _Parts) -> Iterator[Fault]:
    if mesh.is_empty:
        return
    normals_at = parts.at + mesh.positions.nbytes
    indices_at = normals_at + mesh.normals.nbytes
    used = sum(buffer.nbytes for buffer in _buffers(mesh))
    item = mesh.triangles.itemsize
    if len(parts.binary) - used >= gltf.ALIGNMENT or any(parts.binary[used:]):
        yield Fault(
            f"byte {parts.at + used}", f"{len(parts.binary) - used} bytes follow the indices: too many, or not 0"
        )

    def at(start: int, stride: int, row: int) -> str:
        return f"byte {start + stride * row}"

    yield from padding_faults(mesh.positions[:, 3], partial(at, parts.at, POSITION_STRIDE))
    at_normal, at_index = partial(at, normals_at, NORMAL_STRIDE), partial(at, indices_at, item)
    lattice = mesh.positions[:, :3].astype(np.int64)
    yield from geometry_faults(Geometry(lattice, mesh.normals[:, :3], mesh.triangles.reshape(-1), at_normal, at_index))
