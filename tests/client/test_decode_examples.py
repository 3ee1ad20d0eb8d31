"""The worked examples of docs/wire/native-v1.md, decoded."""

import numpy as np
import pytest

from chunkserver_client import BadChunk, decode
from tests.client.pages import NATIVE, hexdump, stated


@pytest.mark.parametrize("name", ["std", "f32", "empty"])
def test_header_of_each_example(name: str):
    mesh, says = decode(hexdump(NATIVE, name)), stated(NATIVE, name)
    assert mesh.key == (says["lod"], says["x"], says["y"], says["z"])
    assert (mesh.cells, mesh.voxel_size, mesh.revision) == (says["cells"], says["voxel_size"], says["revision"])
    assert (mesh.coarser, mesh.geometric_error) == (says["coarser"], says["geometric_error"])
    assert mesh.content == ("air", "rock", "surface")[says["content"]]
    assert mesh.profile == ("std", "f32")[says["profile"]]
    assert (list(mesh.low), list(mesh.high)) == (says["low"], says["high"])


@pytest.mark.parametrize("name", ["std", "f32"])
def test_arrays_of_each_example(name: str):
    mesh, says = decode(hexdump(NATIVE, name)), stated(NATIVE, name)
    assert mesh.positions.tolist() == [position[:3] for position in says["positions"]]
    assert mesh.normals == pytest.approx(np.array(says["normals"])[:, :3], rel=1e-7)
    assert mesh.triangles.ravel().tolist() == says["indices"]
    assert mesh.positions_in_metres().tolist() == says["metres"]
    assert mesh.chunk_positions().tolist() == [position[:3] for position in stated(NATIVE, "std")["positions"]]


def test_the_empty_example_has_arrays_of_length_0():
    mesh = decode(hexdump(NATIVE, "empty"))
    assert mesh.is_empty
    for array in (mesh.positions, mesh.normals, mesh.triangles, mesh.lattice_positions(), mesh.unit_normals()):
        assert array.shape == (0, 3)
    assert mesh.positions_in_metres((1, 2, 3)).shape == (0, 3)


@pytest.mark.parametrize("name", ["std", "f32"])
def test_arrays_are_read_only_views_of_the_bytes(name: str):
    file = hexdump(NATIVE, name)
    held = np.frombuffer(file, np.uint8)
    mesh = decode(file)
    for array in (mesh.positions, mesh.normals, mesh.triangles):
        assert np.shares_memory(array, held)
        assert not array.flags.writeable
        assert not decode(bytearray(file)).positions.flags.writeable


def test_a_file_inside_a_larger_buffer():
    file = hexdump(NATIVE, "std")
    for shift in (1, 16):
        found = decode(memoryview(b"x" * shift + file + b"y")[shift:-1])
        assert found.positions.tolist() == decode(file).positions.tolist()


def test_an_unknown_media_type_is_refused_by_name():
    with pytest.raises(BadChunk, match="text/html"):
        decode(hexdump(NATIVE, "std"), "text/html; charset=utf-8")
