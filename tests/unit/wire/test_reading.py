"""What the readers say of right files, of files with one thing wrong, and of files that nobody wrote."""

import json
import re
import struct
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.wire import FORMATS, Encoding, Placement, encode
from chunkserver.wire.reading import Findings
from tests import scale
from tests.unit.wire.meshes import PLACEMENT, strip

STD, F32, GLB, GLB_CHUNK = Encoding(), Encoding(profile="f32"), Encoding("glb"), Encoding("glb", frame="chunk")
ENCODINGS = [STD, F32, GLB, GLB_CHUNK]
SECONDS_MAX = 1.0


def written(encoding: Encoding, vertices: int = 40, placement: Placement = PLACEMENT) -> bytes:
    mesh = strip(vertices, encoding.normals) if vertices else EMPTY["rock"]
    return encode(mesh, placement, encoding)


def examined(file: bytes) -> Findings:
    """Return what the format's reader says, within the time that it may take; its facts are JSON."""
    (row,) = (row for row in FORMATS.values() if file.startswith(row.magic))
    return examined_as(row.name, file)


def examined_as(name: str, file: bytes) -> Findings:
    begun = time.process_time()
    found = FORMATS[name].examine(file)
    assert time.process_time() - begun < SECONDS_MAX
    json.dumps(found.facts, allow_nan=False)
    return found


@pytest.mark.parametrize("vertices", [0, 3, 40, 65535, 65536])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_the_writers_write_is_right(encoding: Encoding, vertices: int):
    file = written(encoding, vertices)
    facts, faults = examined(file)
    assert faults == []
    assert (facts["format"], facts["bytes"], facts["profile"]) == (encoding.format, len(file), encoding.profile)
    assert (facts["key"], facts["cells"]) == (PLACEMENT.key._asdict(), 32)
    assert (facts["voxel_size"], facts["revision"], facts["coarser"]) == (0.5, "7", 0)
    assert facts["content"] == ("surface" if vertices else "rock")
    assert (facts["vertices"], facts["triangles"]) == (vertices, max(vertices - 2, 0))
    assert facts.get("frame", "world") == encoding.frame
    assert [block["name"] for block in facts["blocks"]] == ["positions", "normals", "indices"] * (vertices > 0)
    assert (facts["bounds"] is None) == (vertices == 0)


def test_bounds_are_those_of_the_mesh():
    lattice = strip(40).positions[:, :3].astype(int)
    unit = 0.5 * 4 * 32 / 32768
    corner = 32768 * np.array(PLACEMENT.key[1:]) - 16384
    for encoding in ENCODINGS:
        bounds = examined(written(encoding)).facts["bounds"]
        for name, ends in (("low", lattice.min(axis=0)), ("high", lattice.max(axis=0))):
            assert bounds["lattice"][name] == ends.tolist()
            assert bounds["metres"][name] == (unit * (corner + ends)).tolist()


@pytest.mark.parametrize("voxel_size", [0.1, 0.3, 1 / 3, 2.0**-20, 1048575.7])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_voxel_size_that_is_no_power_of_two(encoding: Encoding, voxel_size: float):
    placement = Placement(ChunkKey(3, -(1 << 20), 5, 1 << 19), 16, voxel_size)
    assert examined(written(encoding, 500, placement)).faults == []


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_geometric_error_is_read_back(encoding: Encoding):
    for error, told in ((0.375, 0.375), (0.0, 0.0), (-1.0, None)):
        found = examined(written(encoding, 5, PLACEMENT._replace(geometric_error=error)))
        assert (found.facts["geometric_error"], found.faults) == (told, [])


@pytest.mark.parametrize("vertices", [0, 5])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_file_that_is_cut_anywhere_is_not_right(encoding: Encoding, vertices: int):
    file = written(encoding, vertices)
    for length in range(len(file)):
        assert examined_as(encoding.format, file[:length]).faults, length


@pytest.mark.parametrize("vertices", [0, 5])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_no_byte_can_be_changed_so_that_a_reader_fails(encoding: Encoding, vertices: int, rng: np.random.Generator):
    file = np.frombuffer(written(encoding, vertices), np.uint8)
    for place in range(len(file)):
        for value in (0, 127, 255, file[place] ^ 128):
            changed = file.copy()
            changed[place] = value
            examined_as(encoding.format, changed.tobytes())
    for _ in range(scale.count(40_000)):
        changed = file.copy()
        changed[rng.integers(0, len(file), 4)] = rng.integers(0, 256, 4)
        examined_as(encoding.format, changed.tobytes())


def put(offset: int, layout: str, *values: Any) -> Callable[[bytes], bytes]:
    """Return the edit that writes values at an offset."""

    def edit(file: bytes) -> bytes:
        changed = bytearray(file)
        struct.pack_into(f"<{layout}", changed, offset, *values)
        return bytes(changed)

    return edit


POSITIONS = 96 + 3 * 16
NORMALS = POSITIONS + 40 * 8
INDICES = NORMALS + 40 * 4
NATIVE_FAULTS = [
    (0, "4s", b"GLTF", "magic"),
    (4, "H", 2, "version is 2; wanted is 1"),
    (6, "H", 95, "header_bytes is 95"),
    (6, "H", 65535, "ends at byte 65583"),
    (8, "q", 1 << 50, "x is 1125899906842624"),
    (32, "Q", 1 << 63, "revision is 9223372036854775808"),
    (40, "d", float("nan"), "voxel_size is nan"),
    (48, "I", 0xFFFFFFFF, "vertex_count is 4294967295"),
    (48, "I", 39, "byte_length of a block is 320; wanted is 312"),
    (52, "I", 7, "index_count is 7"),
    (56, "f", float("inf"), "geometric_error is inf"),
    (56, "f", -2.0, "geometric_error is -2.0"),
    (60, "H", 33, "cells is 33"),
    (62, "B", 21, "lod is 21"),
    (63, "B", 9, "profile is 9; wanted is 0 (std) or 1 (f32)"),
    (64, "B", 64, "coarser is 64"),
    (65, "B", 3, "content is 3"),
    (65, "B", 0, "vertex_count is 40; wanted is 0 in an empty chunk"),
    (66, "B", 4, "index_bytes is 4; wanted is 2"),
    (67, "B", 2, "block_count is 2"),
    (67, "B", 255, "the table of 255 blocks"),
    (68, "I", 17, "file_bytes is 17"),
    (72, "H", 1, "low is [1, "),
    (82, "H", 1, "high is ["),
    (96, "H", 3, "there are 0 blocks of positions"),
    (98, "H", 5121, "component_type of a block is 5121; wanted is 5123"),
    (100, "H", 3, "components of a block is 3; wanted is 4"),
    (102, "H", 12, "stride of a block is 12; wanted is 8"),
    (104, "I", POSITIONS + 8, "offset of a block is 152"),
    (108, "I", 0xFFFFFFFF, "byte_length of a block is 4294967295; wanted is at most"),
    (120, "I", 16, "offset of a block is 16"),
    (POSITIONS + 8 * 7 + 6, "H", 0, "of 1 positions the fourth component"),
    (NORMALS + 4 * 3, "3b", 127, 127, 0, "of 1 normals the length"),
    (INDICES + 6, "H", 40, "1 indices name no vertex: there are 40"),
    (INDICES + 6, "3H", 5, 5, 6, "1 triangles have no area"),
    (INDICES + 38 * 6, "H", 1, "padding is not zero"),
]


@pytest.mark.parametrize("fault", NATIVE_FAULTS, ids=lambda fault: fault[-1])
def test_what_is_wrong_with_a_native_file_is_named_by_its_byte(fault: tuple[Any, ...]):
    offset, layout, *values, said = fault
    faults = examined_as("mesh", put(offset, layout, *values)(written(STD))).faults
    (found,) = (fault for fault in faults if said in fault.what)
    named = int(found.where.removeprefix("byte "))
    moved = any(words in said for words in ("ends at", "the table", "in an empty", "low is", "high is", "byte_length"))
    if not moved:
        assert offset - 6 <= named <= offset


def test_floats_are_on_the_lattice():
    said = r"1 positions are not on the chunk's lattice"
    for value in (float("nan"), float("inf"), 1e30, 0.0009765626):
        faults = examined(put(POSITIONS + 12 * 9, "f", value)(written(F32))).faults
        assert [(fault.where, fault.what) for fault in faults] == [(f"byte {POSITIONS + 12 * 9}", said)]


def test_blocks_that_a_later_writer_adds_are_left_alone():
    file = written(STD)
    for offset, layout, values in ((67, "B", (4,)), (6, "H", (112,)), (68, "I", (len(file) + 48,))):
        file = put(offset, layout, *values)(file)
    rows = [list(struct.unpack_from("<4H2I", file, 96 + 16 * row)) for row in range(3)]
    table = b"".join(struct.pack("<4H2I", *row[:4], row[4] + 32, row[5]) for row in rows)
    later = struct.pack("<4H2I", 99, 5121, 1, 1, len(file) + 32, 16)
    assert examined(file[:96] + b"\1" * 16 + table + later + file[POSITIONS:] + b"\2" * 16).faults == []


def scene(change: Callable[[dict[str, Any]], object], file: bytes) -> bytes:
    """Return a GLB with its JSON changed."""
    length = struct.unpack_from("<I", file, 12)[0]
    tree = json.loads(file[20 : 20 + length])
    change(tree)
    return with_json(json.dumps(tree).encode(), file)


def with_json(text: bytes, file: bytes) -> bytes:
    length = struct.unpack_from("<I", file, 12)[0]
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + file[20 + length :]
    return struct.pack("<4s2I", b"glTF", 2, 12 + len(body)) + body


GLB_FAULTS: list[tuple[str, object, str]] = [
    ("asset.version", "1.0", "wanted is '2.0'"),
    ("nodes.0.extras", None, "what makes a GLB a chunk"),
    ("nodes.0.extras.lod", None, "is not there"),
    ("nodes.0.extras.lod", 2, "wanted is a decimal integer, as a string"),
    ("nodes.0.extras.lod", "21", "lod is 21"),
    ("nodes.0.extras.x", "007", "wanted is a decimal integer"),
    ("nodes.0.extras.cells", True, "wanted is an integer"),
    ("nodes.0.extras.cells", 24, "cells is 24"),
    ("nodes.0.extras.voxel_size", "1", "wanted is a number"),
    ("nodes.0.extras.content", ["air"], "wanted is one of"),
    ("nodes.0.extras.geometric_error", "1", "wanted is a number, 0 or more"),
    ("nodes.0.extras.geometric_error", -1, "wanted is a number, 0 or more"),
    ("nodes.0.extras.geometric_error", 10**400, "it lies in [0, "),
    ("nodes.0.extras.content", "air", "neither a mesh nor a BIN chunk"),
    ("nodes.0.translation", [0, 0], "wanted is ["),
    ("nodes.0.translation.1", 0.25, "is 0.25"),
    ("nodes.0.scale.2", 1, "is 1"),
    ("accessors.0.count", 41, "the accessors need"),
    ("accessors.0.count", 10**400, "wanted is 1 to 16777216"),
    ("accessors.0.count", -1, "wanted is 1 to 16777216"),
    ("accessors.2.count", 7, "wanted is a multiple of 3"),
    ("accessors.0.min", [0, 0, 0], "is 0"),
    ("accessors.1.normalized", 1, "wanted is True"),
    ("accessors.1.componentType", 5121, "wanted is 5120"),
    ("bufferViews.2.byteOffset", 4, "is 4"),
    ("buffers.0.byteLength", 3, "is 3"),
    ("buffers.0.byteLength", None, "is not there"),
    ("extensionsRequired", [], "wanted is ['KHR_mesh_quantization']"),
]


@pytest.mark.parametrize(("path", "value", "said"), GLB_FAULTS)
def test_what_is_wrong_with_a_glb_is_named_by_its_path(path: str, value: object, said: str):
    *above, last = (int(part) if part.isdecimal() else part for part in path.split("."))

    def change(tree: Any) -> None:
        for part in above:
            tree = tree[part]
        if value is None:
            del tree[last]
        else:
            tree[last] = value

    faults = examined(scene(change, written(GLB))).faults
    found = [fault for fault in faults if said in f"{fault.where} {fault.what}"]
    assert found
    assert re.sub(r"\[(\d+)\]", r".\1", found[0].where).startswith((f"$.{path}", "byte", "$.nodes.0"))


def put_in(name: str, value: object, tree: dict[str, Any]) -> None:
    tree[name] = value


def test_deep_values_where_a_list_should_be():
    deep: list[object] = []
    for _ in range(600):
        deep = [deep]
    for name in ("extensionsUsed", "buffers", "accessors"):
        (fault,) = examined(scene(partial(put_in, name, deep), written(GLB))).faults
        assert fault == ("$", "is nested deeper than 16 levels")
    odd = examined(scene(lambda tree: tree.update(extensionsUsed=[7, "x"]), written(GLB)))
    assert odd.facts["extensions"] == ["x"]
    assert [fault.where for fault in odd.faults] == ["$.extensionsUsed"]


def test_more_members_are_no_fault():
    assert examined(scene(lambda tree: tree["asset"].update(copyright="me"), written(GLB))).faults == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"[" * 60_000, "is nested deeper"),
        (b'{"a":' * 12_000, "is nested deeper"),
        (b"[" * 900 + b"]" * 900, "is nested deeper"),
        (b"{}", "$.nodes[0].extras is not there"),
        (b"[]", "$.nodes[0].extras is not there"),
        (b"NaN", "NaN is no number"),
        (b"9" * 5_000, "is no JSON"),
        (b"\xff\xfe", "is no JSON"),
        (b" " * 70_000, "less than 65536"),
    ],
)
def test_json_that_nobody_writes(text: bytes, said: str):
    (fault,) = examined(with_json(text, written(GLB))).faults
    assert said in f"{fault.where} {fault.what}"
    assert len(fault.what) < 200


@pytest.mark.parametrize(
    ("offset", "layout", "value", "said"),
    [
        (4, "I", 1, "byte 0: magic and version"),
        (8, "I", 1, "byte 8: the length is 1"),
        (12, "I", 1 << 31, "byte 12: the length of the b'JSON' chunk is 2147483648"),
        (16, "4s", b"BIN\0", "byte 16: the chunk is b'BIN\\x00'"),
    ],
)
def test_what_is_wrong_with_the_container_is_named_by_its_byte(offset: int, layout: str, value: Any, said: str):
    (fault,) = examined(put(offset, layout, value)(written(GLB))).faults
    assert f"{fault.where}: {fault.what}".startswith(said)


def test_what_is_wrong_with_the_mesh_of_a_glb_is_named_by_its_byte():
    file = written(GLB)
    begin = len(file) - 40 * 12 - 38 * 6
    for offset, layout, values, said in (
        (8 * 7 + 6, "H", (0,), "the fourth component"),
        (40 * 8 + 4 * 3, "3b", (127, 127, 0), "the length is not 1"),
        (40 * 12, "H", (40,), "1 indices name no vertex"),
        (40 * 12, "3H", (5, 5, 6), "1 triangles have no area"),
    ):
        faults = examined(put(begin + offset, layout, *values)(file)).faults
        assert [said in fault.what for fault in faults] == [True]
        assert begin + offset - 6 <= int(faults[0].where.removeprefix("byte ")) <= begin + offset


def test_a_triangle_without_area_though_its_corners_differ():
    mesh = strip(4)
    positions = mesh.positions.copy()
    positions[:3, :3] = [[16384, 16384, 16384], [17384, 17384, 17384], [18384, 18384, 18384]]
    flat = Mesh("surface", positions, mesh.normals, mesh.triangles)
    for encoding in (STD, GLB):
        (fault,) = examined(encode(flat, PLACEMENT, encoding)).faults
        assert fault.what == "1 triangles have no area"
