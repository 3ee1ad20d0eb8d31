"""Offsets are written here as numbers, from docs/wire/native-v1.md, so that a moved field cannot move its test."""

import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given

from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Content
from chunkserver.wire import Encoding, Placement, encode
from tests.unit.wire.meshes import PLACEMENT, placements, powers_of_two, strip

STD, F32 = Encoding(), Encoding(profile="f32")


def blocks(file: bytes) -> list[tuple[int, ...]]:
    """Return (kind, component type, components, stride, offset, byte length) of each block."""
    return [struct.unpack_from("<HHHHII", file, 96 + 16 * row) for row in range(file[67])]


@pytest.mark.parametrize("encoding", [STD, F32])
@given(placement=placements(powers_of_two))
def test_header(encoding: Encoding, placement: Placement):
    mesh = strip(5, encoding.normals)
    file = encode(mesh, placement, encoding)
    assert file[:8] == b"CHNK\x01\x00\x60\x00"
    assert struct.unpack_from("<qqqQd", file, 8) == (*placement.key[1:], placement.revision, placement.voxel_size)
    assert struct.unpack_from("<IIf", file, 48) == (5, 9, np.float32(placement.geometric_error))
    assert struct.unpack_from("<HB", file, 60) == (placement.cells, placement.key.lod)
    profile, index_bytes = (0, 2) if encoding == STD else (1, 4)
    assert tuple(file[63:68]) == (profile, placement.coarser, 2, index_bytes, 3)
    assert struct.unpack_from("<I", file, 68) == (len(file),)
    assert struct.unpack_from("<3H", file, 72) == tuple(mesh.positions[:, :3].min(axis=0))
    assert struct.unpack_from("<3H", file, 78) == tuple(mesh.positions[:, :3].max(axis=0))
    assert file[84:96] == bytes(12)


@pytest.mark.parametrize("encoding", [STD, F32])
@pytest.mark.parametrize("vertices", range(3, 20))
def test_blocks_are_aligned_packed_and_padded_with_zeros(vertices: int, encoding: Encoding):
    file = encode(strip(vertices, encoding.normals), PLACEMENT, encoding)
    assert len(file) % 16 == 0
    end = 96 + 3 * 16
    for _kind, _type, _components, _stride, offset, byte_length in blocks(file):
        assert offset % 16 == 0
        assert 0 <= offset - end < 16
        assert file[end:offset] == bytes(offset - end)
        end = offset + byte_length
    assert 0 <= len(file) - end < 16
    assert file[end:] == bytes(len(file) - end)


def test_blocks_std():
    mesh = strip(7)
    file = encode(mesh, PLACEMENT, STD)
    positions, normals, indices = blocks(file)
    assert positions[:4] + positions[5:] == (1, 5123, 4, 8, 56)
    assert normals[:4] + normals[5:] == (2, 5120, 4, 4, 28)
    assert indices[:4] + indices[5:] == (3, 5123, 1, 2, 30)
    assert np.array_equal(np.frombuffer(file, "<u2", 28, positions[4]).reshape(-1, 4), mesh.positions)
    assert np.array_equal(np.frombuffer(file, "i1", 28, normals[4]).reshape(-1, 4), mesh.normals)
    assert np.array_equal(np.frombuffer(file, "<u2", 15, indices[4]).reshape(-1, 3), mesh.triangles)


def test_blocks_f32():
    mesh = strip(7, "float32")
    file = encode(mesh, PLACEMENT, F32)
    positions, normals, indices = blocks(file)
    assert positions[:4] + positions[5:] == (1, 5126, 3, 12, 84)
    assert normals[:4] + normals[5:] == (2, 5126, 3, 12, 84)
    assert indices[:4] + indices[5:] == (3, 5125, 1, 4, 60)
    assert np.array_equal(np.frombuffer(file, "<f4", 21, normals[4]).reshape(-1, 3), mesh.normals)
    assert np.array_equal(np.frombuffer(file, "<u4", 15, indices[4]).reshape(-1, 3), mesh.triangles)


@pytest.mark.parametrize(("vertices", "component_type", "index_bytes"), [(65535, 5123, 2), (65536, 5125, 4)])
def test_indices_widen_before_65535_would_occur(vertices: int, component_type: int, index_bytes: int):
    mesh = strip(vertices)
    file = encode(mesh, PLACEMENT, STD)
    _, _, (_, found, _, stride, offset, byte_length) = blocks(file)
    assert (found, stride, file[66], byte_length) == (
        component_type,
        *[index_bytes] * 2,
        index_bytes * mesh.triangles.size,
    )
    indices = np.frombuffer(file, f"<u{index_bytes}", byte_length // index_bytes, offset)
    assert np.array_equal(indices.reshape(-1, 3), mesh.triangles)
    assert (65535 in indices) == (vertices == 65536)


def f32_positions(voxel_size: float, key: ChunkKey, cells: int) -> np.ndarray:
    """Return, for every position from 0 to 65535, the three floats of a vertex with it on all axes."""
    mesh = strip(65536, "float32")
    mesh.positions[:, :3] = np.arange(65536, dtype=np.uint16)[:, None]
    file = encode(mesh, Placement(key, cells, voxel_size), F32)
    return np.frombuffer(file, "<f4", 3 * 65536, blocks(file)[0][4]).reshape(-1, 3)


@pytest.mark.parametrize(
    ("voxel_size", "lod", "cells"), [(1.0, 0, 32), (0.5, 20, 64), (2.0**-20, 0, 64), (2.0**20, 20, 64), (0.25, 3, 16)]
)
def test_f32_is_the_lattice_position(voxel_size: float, lod: int, cells: int):
    found = f32_positions(voxel_size, ChunkKey(lod, -1, 0, 0), cells)
    unit = Fraction(voxel_size) * 2**lod * cells / 32768
    for position in (0, 1, 16383, 16384, 16385, 32767, 49152, 65535):
        assert [Fraction(float(value)) for value in found[position]] == [unit * (position - 16384)] * 3
    exact = (np.arange(65536.0) - 16384) * float(unit)  # float64 holds it
    assert np.array_equal(found, np.repeat(exact[:, None], 3, axis=1))


def test_f32_is_rounded_once_for_other_voxel_sizes():
    unit = Fraction(0.1) * 4 * 32 / 32768
    found = f32_positions(0.1, ChunkKey(2, 0, 0, 0), 32)[:, 0]
    for position in range(0, 65536, 97):
        exact = unit * (position - 16384)
        assert abs(Fraction(float(found[position])) - exact) <= abs(exact) / 2**24


@pytest.mark.parametrize(("content", "code"), [("air", 0), ("rock", 1)])
@pytest.mark.parametrize("encoding", [STD, F32])
def test_an_empty_chunk_is_its_header(content: Content, code: int, encoding: Encoding):
    file = encode(EMPTY[content], PLACEMENT, encoding)
    full = encode(strip(5, encoding.normals), PLACEMENT, encoding)
    assert len(file) == 96
    assert file[:48] == full[:48]
    assert file[48:56] == bytes(8)
    assert file[56:65] == full[56:65]
    assert tuple(file[65:68]) == (code, 0, 0)
    assert file[68:96] == b"\x60\x00\x00\x00" + bytes(24)
