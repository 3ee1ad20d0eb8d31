"""glTF binary (GLB): one mesh, one primitive, positions on the lattice, placed by the node. See docs/wire/glb.md.

    12 bytes | JSON chunk, padded with spaces | BIN chunk: positions | normals | indices, padded with zeros

An empty chunk has neither mesh nor BIN chunk.
"""

import json
import struct
from typing import Any, Final

from numpy.typing import NDArray

from chunkserver.mesh import Mesh
from chunkserver.wire.buffers import bounds, component_type
from chunkserver.wire.encoding import GEOMETRIC_ERROR_NOT_STATED, Encoding, Placement

CONTAINER: Final = struct.Struct("<4s2I")
CHUNK: Final = struct.Struct("<I4s")
MAGIC: Final = b"glTF"
VERSION: Final = 2
ALIGNMENT: Final = 4

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
QUANTIZATION: Final = "KHR_mesh_quantization"

MATERIAL: Final = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
"""glTF's own default is a metal, which viewers without an environment map show black."""

_JSON: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)


def encode(mesh: Mesh, placement: Placement, encoding: Encoding) -> bytes:
    """Return `mesh` as GLB. An empty mesh gives a node with its place and extras, and no mesh."""
    buffers = [] if mesh.is_empty else [mesh.positions, mesh.normals, mesh.triangles]
    return _container(scene_of(mesh, placement, encoding.frame, buffers), buffers)


def scene_of(mesh: Mesh, placement: Placement, frame: str, buffers: list[NDArray[Any]]) -> dict[str, Any]:
    """Return the JSON of a GLB. buffers: what its views hold, in their order; none for an empty mesh."""
    scene: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "chunkserver"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [_node(mesh, placement, frame)],
    }
    if not buffers:
        return scene
    scene["nodes"][0]["mesh"] = 0
    return scene | _geometry(mesh, buffers)


def _node(mesh: Mesh, placement: Placement, frame: str) -> dict[str, Any]:
    """translation + scale * position is the world position, or with frame "chunk" the offset from the low corner."""
    key, cells, _, revision, coarser, error = placement
    voxel_size = float(placement.voxel_size)  # 1 and 1.0 are equal requests: they get equal JSON
    corner = key.low_corner(cells) if frame == "world" else (0, 0, 0)
    return {
        "translation": [voxel_size * (low - placement.margin) for low in corner],
        "scale": [placement.unit] * 3,
        "extras": {
            "lod": str(key.lod),
            "x": str(key.x),
            "y": str(key.y),
            "z": str(key.z),
            "cells": cells,
            "voxel_size": voxel_size,
            "revision": str(revision),
            "coarser": coarser,
            "content": mesh.content,
            **({} if error == GEOMETRIC_ERROR_NOT_STATED else {"geometric_error": float(error)}),
        },
    }


def _geometry(mesh: Mesh, buffers: list[NDArray[Any]]) -> dict[str, Any]:
    positions, normals, indices = buffers
    low, high = bounds(mesh)
    return {
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}]}],
        "materials": [MATERIAL],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": component_type(positions),
                "count": len(positions),
                "type": "VEC3",
                "min": low,
                "max": high,
            },
            {
                "bufferView": 1,
                "componentType": component_type(normals),
                "normalized": True,
                "count": len(normals),
                "type": "VEC3",
            },
            {
                "bufferView": 2,
                "componentType": component_type(indices),
                "count": indices.size,
                "type": "SCALAR",
            },
        ],
        "bufferViews": _views(buffers),
        "buffers": [{"byteLength": sum(buffer.nbytes for buffer in buffers)}],
        "extensionsUsed": [QUANTIZATION],
        "extensionsRequired": [QUANTIZATION],
    }


def _views(buffers: list[NDArray[Any]]) -> list[dict[str, int]]:
    """One view a buffer, one after the other: positions and normals end on multiples of 4 by themselves."""
    views = []
    offset = 0
    for buffer, target in zip(buffers, (ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER), strict=True):
        view = {"buffer": 0, "byteOffset": offset, "byteLength": buffer.nbytes, "target": target}
        if target == ARRAY_BUFFER:
            view["byteStride"] = buffer.strides[0]
        views.append(view)
        offset += buffer.nbytes
    return views


def _container(scene: dict[str, Any], buffers: list[NDArray[Any]]) -> bytes:
    text = _JSON.encode(scene).encode()
    text += b" " * (-len(text) % ALIGNMENT)
    parts: list[Any] = [CHUNK.pack(len(text), b"JSON"), text]
    if buffers:
        byte_length = sum(buffer.nbytes for buffer in buffers)
        padding = -byte_length % ALIGNMENT
        parts += [CHUNK.pack(byte_length + padding, b"BIN\0"), *(buffer.data for buffer in buffers), bytes(padding)]
    length = CONTAINER.size + sum(memoryview(part).nbytes for part in parts)
    return b"".join([CONTAINER.pack(MAGIC, VERSION, length), *parts])
