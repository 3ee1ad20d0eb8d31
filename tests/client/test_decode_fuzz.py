"""Truncated and mutated bytes: a `BadChunk`, or a chunk whose arrays can be trusted; never another exception."""

import struct
from contextlib import suppress

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given

from chunkserver_client import GLB_MEDIA_TYPE, MESH_MEDIA_TYPE, BadChunk, ChunkMesh, decode
from tests.client.gltf import empty_glb, glb, scene
from tests.client.pages import NATIVE, hexdump

FILES = {
    "std": (hexdump(NATIVE, "std"), MESH_MEDIA_TYPE),
    "f32": (hexdump(NATIVE, "f32"), MESH_MEDIA_TYPE),
    "empty": (hexdump(NATIVE, "empty"), MESH_MEDIA_TYPE),
    "glb": (glb(scene()), GLB_MEDIA_TYPE),
    "empty glb": (empty_glb(), GLB_MEDIA_TYPE),
}


def use(mesh: ChunkMesh) -> None:
    """Do with a mesh what people do."""
    vertices = len(mesh.positions)
    assert mesh.positions.shape == mesh.normals.shape == (vertices, 3)
    assert mesh.triangles.shape[1] == 3
    assert mesh.triangles.size == 0 or mesh.triangles.max() < vertices
    chunk = mesh.chunk_positions()
    assert chunk.size == 0 or (chunk.min() >= 0 and chunk.max() <= 65535)
    assert np.abs(mesh.lattice_positions()).max(initial=0) < 1 << 53
    assert np.isfinite(mesh.positions_in_metres((1 << 40, 0, -(1 << 40)))).all()
    assert np.isfinite(mesh.unit_normals()).all()
    assert mesh.is_empty == (mesh.content != "surface")


def survives(content: bytes, media_type: str) -> None:
    with suppress(BadChunk):
        use(decode(content, media_type))


@pytest.mark.parametrize("name", FILES)
def test_every_whole_file_can_be_used(name: str):
    use(decode(*FILES[name]))


@pytest.mark.parametrize("name", FILES)
def test_every_truncation_is_refused(name: str):
    content, media_type = FILES[name]
    for length in range(len(content)):
        with pytest.raises(BadChunk):
            decode(content[:length], media_type)
    with pytest.raises(BadChunk):
        decode(content + bytes(16), media_type)


@pytest.mark.parametrize("name", FILES)
def test_every_byte_flipped(name: str):
    content, media_type = FILES[name]
    for at in range(len(content)):
        for mask in (1, 0x80, 0xFF):
            survives(content[:at] + bytes([content[at] ^ mask]) + content[at + 1 :], media_type)


WORDS = st.one_of(
    st.integers(0, 255).map(lambda value: bytes([value])),
    st.integers(0, 0xFFFF).map(lambda value: struct.pack("<H", value)),
    st.integers(0, 0xFFFFFFFF).map(lambda value: struct.pack("<I", value)),
    st.floats(width=32).map(lambda value: struct.pack("<f", value)),
    st.floats().map(lambda value: struct.pack("<d", value)),
    st.sampled_from([b"\0" * 8, b"\xff" * 8, b"-1", b"1e9", b"null", b"[]", b'""', b"{}"]),
)
EDITS = st.lists(st.tuples(st.integers(0, 4000), WORDS), min_size=1, max_size=4)


@given(st.sampled_from(sorted(FILES)), EDITS, st.booleans())
@example("std", [(68, struct.pack("<I", 208 * 2))], True)
def test_words_written_anywhere(name: str, edits: list[tuple[int, bytes]], twice: bool):
    content, media_type = FILES[name]
    changed = bytearray(content * 2 if twice else content)
    for at, word in edits:
        start = at % len(content)
        changed[start : start + len(word)] = word
    survives(bytes(changed), media_type)


@given(st.binary(max_size=300), st.sampled_from([b"", b"CHNK\x01\x00\x60\x00", b"glTF\x02\x00\x00\x00"]))
def test_any_bytes(content: bytes, magic: bytes):
    for media_type in (MESH_MEDIA_TYPE, GLB_MEDIA_TYPE):
        survives(magic + content, media_type)


def test_a_count_far_too_large_is_refused_before_anything_is_allocated():
    content = bytearray(hexdump(NATIVE, "std"))
    content[48:52] = struct.pack("<I", (1 << 24) + 1)
    with pytest.raises(BadChunk, match="vertex_count"):
        decode(content)
    content[48:52] = struct.pack("<I", 1 << 24)
    with pytest.raises(BadChunk, match="block 0"):
        decode(content)


@pytest.mark.parametrize(
    ("at", "word", "says"),
    [
        (192, struct.pack("<H", 4), "an index is 4: there are 4 vertices"),
        (104, struct.pack("<I", 96), "at 96"),
        (104, struct.pack("<I", 152), "at 152"),
        (52, struct.pack("<I", 5), "three a triangle"),
        (6, struct.pack("<H", 80), "table"),
        (6, struct.pack("<H", 65535), "table"),
        (66, b"\x03", "index_bytes is 3"),
        (63, b"\x02", "profile is 2"),
        (64, b"\x40", "coarser is 64"),
        (65, b"\x03", "content is 3"),
        (65, b"\x00", "content is air"),
        (67, b"\x02", r"no block of kind \[3\]"),
        (96, b"\x02", "kind 2"),
        (39, b"\x80", "revision"),
        (56, struct.pack("<f", -2.0), "geometric_error is -2"),
        (56, struct.pack("<f", float("nan")), "geometric_error is nan"),
        (72, struct.pack("<H", 17409), "above high"),
    ],
)
def test_each_rule_of_the_page(at: int, word: bytes, says: str):
    content = bytearray(hexdump(NATIVE, "std"))
    content[at : at + len(word)] = word
    with pytest.raises(BadChunk, match=says):
        decode(content)


def test_an_index_beyond_the_vertices_of_a_glb(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tests.client.gltf.INDICES", np.array([0, 2, 1, 1, 2, 4], "<u2"))
    with pytest.raises(BadChunk, match="an index is 4"):
        decode(glb(scene()), GLB_MEDIA_TYPE)


def test_blocks_of_a_later_writer_are_skipped():
    content = bytearray(hexdump(NATIVE, "std"))
    content[67] = 4
    content[68:72] = struct.pack("<I", len(content) + 16)
    for row in range(3):
        at = 96 + 16 * row + 8
        content[at : at + 4] = struct.pack("<I", struct.unpack_from("<I", content, at)[0] + 16)
    content[96:96] = struct.pack("<4H2I", 77, 1, 2, 3, 4, 5)
    mesh, wanted = decode(content), decode(hexdump(NATIVE, "std"))
    assert mesh.positions.tolist() == wanted.positions.tolist()
    assert mesh.triangles.tolist() == wanted.triangles.tolist()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e9, -1e9])
@pytest.mark.parametrize("at", [144, 192])
def test_floats_that_cannot_be_are_refused(value: float, at: int):
    content = bytearray(hexdump(NATIVE, "f32"))
    content[at : at + 4] = struct.pack("<f", value)
    with pytest.raises(BadChunk, match="position" if at == 144 else "normal"):
        decode(content)
