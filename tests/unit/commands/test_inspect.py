import json

import pytest

from chunkserver.commands import inspect
from chunkserver.mesh import EMPTY
from chunkserver.wire import Encoding, encode
from tests.unit.commands.typed import refused, run
from tests.unit.wire.meshes import PLACEMENT, strip

NATIVE, GLB = Encoding(), Encoding("glb")


@pytest.fixture
def file(tmp_path):
    return tmp_path / "a.chunk"


def lines_of(stdout):
    return {line[:10].strip(): line[11:] for line in stdout.splitlines()}


@pytest.mark.parametrize("encoding", [NATIVE, GLB, Encoding("glb", frame="chunk"), Encoding(profile="f32")])
def test_what_is_in_a_file(file, encoding):
    body = encode(strip(40, encoding.normals), PLACEMENT, encoding)
    file.write_bytes(body)
    ended = run("inspect", file)
    assert (ended.exit_code, ended.stderr) == (0, "")
    said = lines_of(ended.stdout)
    assert said["format"] == f"{encoding.format}, {len(body):,} bytes"
    assert said["chunk"] == "lod 2, x -3, y 0, z 5"
    assert said["cells"] == "32 a side, voxels of 0.5 m"
    assert said["content"] == "surface, revision 7, coarser 0"
    assert said["profile"].startswith(encoding.profile)
    assert ("frame chunk" in said["profile"]) == (encoding.frame == "chunk")
    assert said["mesh"] == "40 vertices, 38 triangles"
    assert said["indices"].startswith("1 x uint")
    assert said[""].startswith("it is what docs/wire says")


@pytest.mark.parametrize("encoding", [NATIVE, GLB])
def test_blocks_are_where_it_says(file, encoding):
    mesh = strip(40)
    file.write_bytes(encode(mesh, PLACEMENT, encoding))
    told = json.loads(run("inspect", file, "--json").stdout)
    body = file.read_bytes()
    for block, array in zip(told["blocks"], (mesh.positions, mesh.normals, mesh.triangles.astype("<u2")), strict=True):
        assert body[block["offset"] : block["offset"] + block["bytes"]] == array.tobytes(), block["name"]


@pytest.mark.parametrize("encoding", [NATIVE, GLB])
def test_an_empty_chunk(file, encoding):
    file.write_bytes(encode(EMPTY["rock"], PLACEMENT, encoding))
    ended = run("inspect", file)
    assert ended.exit_code == 0
    assert lines_of(ended.stdout)["content"] == "rock, revision 7, coarser 0"


def test_each_fault_is_a_line(file):
    body = bytearray(encode(strip(40), PLACEMENT, NATIVE))
    body[60], body[68], body[48] = 33, 0, 41
    file.write_bytes(body)
    ended = run("inspect", file)
    assert ended.exit_code == 1
    assert [line.partition(": ")[2].partition(":")[0] for line in ended.stderr.splitlines()] == ["byte 60", "byte 68"]
    assert "it is what" not in ended.stdout
    told = json.loads(run("inspect", file, "--json").stdout)
    assert [fault["where"] for fault in told["faults"]] == ["byte 60", "byte 68"]
    assert told["vertices"] == 41


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "begins with b''"),
        (b"CHN", "begins with b'CHN'"),
        (b"\x1f\x8b\x08\x00 a gzip", "begins with b'\\x1f\\x8b\\x08\\x00'"),
    ],
)
def test_what_is_no_chunk(file, body, said):
    file.write_bytes(body)
    line = refused(1, "inspect", file)
    assert said in line
    assert "CHNK (.mesh) or glTF (.glb)" in line


def test_a_box_is_no_chunk(tmp_path):
    assert run("mesh", tmp_path / "box.glb", "--box", 0, -1, 0, 1, 0, 0).exit_code == 0
    ended = run("inspect", tmp_path / "box.glb")
    assert ended.exit_code == 1
    assert "what makes a GLB a chunk" in ended.stderr


def test_a_file_is_read_so_far_and_no_further(file, monkeypatch):
    monkeypatch.setattr(inspect, "FILE_BYTES_MAX", 100)
    assert "has more than 100 bytes" in refused(1, "inspect", "/dev/zero")
    file.write_bytes(encode(EMPTY["air"], PLACEMENT, NATIVE))
    assert run("inspect", file).exit_code == 0


def test_a_file_that_is_piped_in():
    ended = run("inspect", "-", piped=encode(strip(40), PLACEMENT, GLB))
    assert ended.exit_code == 0
    assert "40 vertices" in ended.stdout


def test_a_file_that_is_not_there(tmp_path):
    assert refused(1, "inspect", tmp_path / "none").endswith("cannot be read: No such file or directory")
    assert refused(1, "inspect", tmp_path).endswith("cannot be read: Is a directory")
