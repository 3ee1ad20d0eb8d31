"""A GLB written from docs/wire/glb.md: the page has no bytes of one, so its words are put into bytes here."""

import json
import struct
from typing import Any, Final

import numpy as np

POSITIONS: Final = np.array(
    [[16384, 20992, 16384], [17408, 20736, 16384], [16384, 20992, 17408], [17408, 20736, 17408]], "<u2"
)
NORMALS: Final = np.array([[31, 123, 0]] * 4, "<i1")
INDICES: Final = np.array([0, 2, 1, 1, 2, 3], "<u2")
UNIT: Final = 0.5 * 4 * 32 / 32768
EXTRAS: Final = {
    "lod": "2",
    "x": "-3",
    "y": "0",
    "z": "5",
    "cells": 32,
    "voxel_size": 0.5,
    "revision": "7",
    "coarser": 0,
    "content": "surface",
}


def padded(values: np.ndarray, size: int, fill: bytes) -> bytes:
    """Return rows with `fill` behind each, up to `size` bytes."""
    return b"".join(row.tobytes().ljust(size, fill) for row in values)


def scene(frame: str = "world") -> dict[str, Any]:
    """Return the JSON of the native page's example as glTF."""
    low = (-3, 0, 5) if frame == "world" else (0, 0, 0)
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {
                "mesh": 0,
                "translation": [0.5 * 4 * 32 * (k - 0.5) for k in low],
                "scale": [UNIT] * 3,
                "extras": dict(EXTRAS),
            }
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5123,
                "count": 4,
                "type": "VEC3",
                "min": [16384, 20736, 16384],
                "max": [17408, 20992, 17408],
            },
            {"bufferView": 1, "componentType": 5120, "normalized": True, "count": 4, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 32, "byteStride": 8},
            {"buffer": 0, "byteOffset": 32, "byteLength": 16, "byteStride": 4},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 60}],
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
    }


def glb(tree: Any) -> bytes:
    """Return a GLB of this JSON, with the arrays of the example."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary = padded(POSITIONS, 8, b"\xff") + padded(NORMALS, 4, b"\0") + INDICES.tobytes()
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4s2I", b"glTF", 2, 12 + len(chunks)) + chunks


def empty_glb() -> bytes:
    """Return a GLB of a chunk that is all rock."""
    tree = scene()
    node = {**tree["nodes"][0], "extras": {**EXTRAS, "content": "rock"}}
    del node["mesh"]
    text = json.dumps({"asset": tree["asset"], "scene": 0, "scenes": tree["scenes"], "nodes": [node]}).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4s2I", b"glTF", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON") + text
