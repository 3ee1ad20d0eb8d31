import json
import struct
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chunkserver.mesh import EMPTY, Content
from chunkserver.wire import Encoding, Placement, encode
from tests.unit.wire.meshes import PLACEMENT, placements, powers_of_two, strip

GLB = Encoding("glb")
CHUNK = Encoding("glb", frame="chunk")


def parts(file: bytes) -> tuple[dict[str, Any], bytes | None]:
    """Return the JSON and the binary part; both headers and the padding are checked on the way."""
    assert struct.unpack_from("<4sII", file) == (b"glTF", 2, len(file))
    length, kind = struct.unpack_from("<I4s", file, 12)
    assert (length % 4, kind) == (0, b"JSON")
    text = file[20 : 20 + length]
    assert len(text) - len(text.rstrip(b" ")) < 4
    rest = file[20 + length :]
    if not rest:
        return json.loads(text), None
    length, kind = struct.unpack_from("<I4s", rest)
    assert (length % 4, kind, len(rest)) == (0, b"BIN\0", 8 + length)
    return json.loads(text), rest[8:]


@pytest.mark.parametrize("vertices", [3, 4, 5, 6, 65535, 65536])
def test_geometry(vertices: int):
    mesh = strip(vertices)
    scene, binary = parts(encode(mesh, PLACEMENT, GLB))
    assert binary is not None
    width = 2 if vertices <= 65535 else 4
    used = 12 * vertices + width * mesh.triangles.size
    assert scene["buffers"] == [{"byteLength": used}]
    assert binary[used:] == bytes(-used % 4)
    positions, normals, indices = scene["accessors"]
    assert [view["byteOffset"] for view in scene["bufferViews"]] == [0, 8 * vertices, 12 * vertices]
    assert [view.get("byteStride") for view in scene["bufferViews"]] == [8, 4, None]
    assert (positions["componentType"], positions["type"], "normalized" in positions) == (5123, "VEC3", False)
    assert positions["min"] == mesh.positions[:, :3].min(axis=0).tolist()
    assert positions["max"] == mesh.positions[:, :3].max(axis=0).tolist()
    assert (normals["componentType"], normals["type"], normals["normalized"]) == (5120, "VEC3", True)
    assert (indices["componentType"], indices["type"]) == (5123 if width == 2 else 5125, "SCALAR")
    assert [accessor["count"] for accessor in scene["accessors"]] == [vertices, vertices, mesh.triangles.size]
    assert np.array_equal(np.frombuffer(binary, "<u2", 4 * vertices).reshape(-1, 4), mesh.positions)
    assert np.array_equal(np.frombuffer(binary, "i1", 4 * vertices, 8 * vertices).reshape(-1, 4), mesh.normals)
    found = np.frombuffer(binary, f"<u{width}", mesh.triangles.size, 12 * vertices)
    assert np.array_equal(found.reshape(-1, 3), mesh.triangles)


def node(placement: Placement, encoding: Encoding) -> dict[str, Any]:
    scene, _ = parts(encode(strip(3), placement, encoding))
    found: dict[str, Any] = scene["nodes"][0]
    return found


@given(placement=placements(powers_of_two), position=st.integers(0, 65535))
def test_world_position_is_exact(placement: Placement, position: int):
    placed = node(placement, GLB)
    for axis, coordinate in enumerate(placement.key[1:]):
        found = placed["translation"][axis] + placed["scale"][axis] * position  # float64, as a client adds
        side = Fraction(placement.voxel_size) * 2**placement.key.lod * placement.cells
        assert Fraction(found) == side * (coordinate + Fraction(position - 16384, 32768))


@given(placement=placements(powers_of_two), position=st.integers(0, 65535))
def test_chunk_frame_starts_at_the_low_corner(placement: Placement, position: int):
    placed = node(placement, CHUNK)
    side = Fraction(placement.voxel_size) * 2**placement.key.lod * placement.cells
    for axis in range(3):
        found = placed["translation"][axis] + placed["scale"][axis] * position
        assert Fraction(found) == side * Fraction(position - 16384, 32768)


@given(placement=placements(st.floats(2.0**-20, 2.0**20)))
def test_other_voxel_sizes_are_rounded_once(placement: Placement):
    placed = node(placement, GLB)
    side = Fraction(placement.voxel_size) * 2**placement.key.lod * placement.cells
    assert [Fraction(scale) for scale in placed["scale"]] == [side / 32768] * 3
    for found, coordinate in zip(placed["translation"], placement.key[1:], strict=True):
        assert found == float(side * (coordinate - Fraction(1, 2)))


@given(placement=placements(st.floats(2.0**-20, 2.0**20)))
def test_extras(placement: Placement):
    key, error = placement.key, placement.geometric_error
    assert node(placement, GLB)["extras"] == {
        "lod": str(key.lod),
        "x": str(key.x),
        "y": str(key.y),
        "z": str(key.z),
        "cells": placement.cells,
        "voxel_size": placement.voxel_size,
        "revision": str(placement.revision),
        "coarser": placement.coarser,
        "content": "surface",
        **({} if error == -1 else {"geometric_error": error}),
    }


def test_the_extension_is_required_where_it_is_used():
    scene, _ = parts(encode(strip(3), PLACEMENT, GLB))
    assert scene["extensionsUsed"] == scene["extensionsRequired"] == ["KHR_mesh_quantization"]


@pytest.mark.parametrize("content", ["air", "rock"])
@pytest.mark.parametrize("encoding", [GLB, CHUNK])
def test_an_empty_chunk_has_a_place_and_no_mesh(content: Content, encoding: Encoding):
    scene, binary = parts(encode(EMPTY[content], PLACEMENT, encoding))
    assert binary is None
    assert set(scene) == {"asset", "scene", "scenes", "nodes"}
    expected = node(PLACEMENT, encoding)
    expected["extras"]["content"] = content
    del expected["mesh"]
    assert scene["nodes"] == [expected]
