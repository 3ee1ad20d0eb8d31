"""Where a vertex is, against fractions: exact to the last bit, however far out."""

import struct
from fractions import Fraction

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from chunkserver_client import BadChunk, decode
from tests.client.pages import NATIVE, hexdump

EXAMPLES = {profile: hexdump(NATIVE, profile) for profile in ("std", "f32")}
VOXELS_MAX = 1 << 40


def placed(key: tuple[int, int, int, int], cells: int, voxel_size: float, profile: str = "std") -> bytearray:
    """Return the page's example, put somewhere else."""
    lod, *xyz = key
    content = bytearray(EXAMPLES[profile])
    content[8:32] = struct.pack("<3q", *xyz)
    content[40:48] = struct.pack("<d", voxel_size)
    content[60:63] = struct.pack("<HB", cells, lod)
    if profile == "f32":
        positions = np.array(decode(EXAMPLES["std"]).positions, np.float64) - 16384
        content[144:192] = (positions * (voxel_size * 2.0**lod * cells / 32768)).astype("<f4").tobytes()
    return content


@st.composite
def places(draw: st.DrawFn) -> tuple[tuple[int, int, int, int], int]:
    cells, lod = draw(st.sampled_from([16, 32, 64])), draw(st.integers(0, 20))
    most = VOXELS_MAX // (cells << lod)
    x, y, z = (draw(st.integers(-most, most - 1) | st.sampled_from([-most, most - 1])) for _ in range(3))
    return (lod, x, y, z), cells


def exact(key: tuple[int, int, int, int], cells: int, point: list[int]) -> list[Fraction]:
    """Return a vertex in voxels: the page's formula."""
    side = cells << key[0]
    return [side * (k + Fraction(p - 16384, 32768)) for k, p in zip(key[1:], point, strict=True)]


@given(places(), st.sampled_from([2.0**-20, 0.5, 1.0, 2.0**20]), st.sampled_from(["std", "f32"]))
def test_integers_and_metres_are_exact(place, voxel_size: float, profile: str):
    key, cells = place
    mesh = decode(placed(key, cells, voxel_size, profile))
    corner = mesh.place.corner
    points = decode(EXAMPLES["std"]).positions.tolist()
    assert mesh.chunk_positions().tolist() == points
    wanted = [exact(key, cells, point) for point in points]
    scale = 32768 // cells
    assert [[Fraction(n, scale) for n in row] for row in mesh.lattice_positions().tolist()] == wanted
    for origin in ((0, 0, 0), corner, (VOXELS_MAX, -VOXELS_MAX, 7)):
        metres = mesh.positions_in_metres(origin).tolist()
        assert metres == [
            [float(Fraction(voxel_size) * (w - o)) for w, o in zip(row, origin, strict=True)] for row in wanted
        ]
        found = [
            [Fraction(metre) / Fraction(voxel_size) + o for metre, o in zip(row, origin, strict=True)] for row in metres
        ]
        assert found == wanted, "a power of two: nothing was rounded"


@given(places(), st.floats(2.0**-20, 2.0**20))
def test_metres_of_any_voxel_size_are_rounded_once(place, voxel_size: float):
    key, cells = place
    mesh = decode(placed(key, cells, voxel_size))
    for row, point in zip(mesh.positions_in_metres(mesh.place.corner).tolist(), mesh.positions.tolist(), strict=True):
        voxels = [w - c for w, c in zip(exact(key, cells, point), mesh.place.corner, strict=True)]
        assert row == [float(Fraction(voxel_size) * voxel) for voxel in voxels]


@given(places())
def test_the_same_point_from_the_finer_level_is_the_same(place):
    (lod, *xyz), cells = place
    if lod == 0:
        return
    coarse = decode(placed((lod, *xyz), cells, 1.0))
    fine = bytearray(placed((lod - 1, *(2 * k for k in xyz)), cells, 1.0))
    doubled = (decode(EXAMPLES["std"]).positions.astype(np.int64) - 16384) * 2 + 16384
    fine[144:176] = np.pad(doubled, ((0, 0), (0, 1)), constant_values=65535).astype("<u2").tobytes()
    assert decode(fine).lattice_positions().tolist() == coarse.lattice_positions().tolist()


def test_a_chunk_out_of_the_world_is_refused():
    most = VOXELS_MAX // 32
    decode(placed((0, most - 1, 0, 0), 32, 1.0))
    decode(placed((0, -most, 0, 0), 32, 1.0))
    for x in (most, -most - 1, 2**63 - 1, -(2**63)):
        with pytest.raises(BadChunk, match="from the origin"):
            decode(placed((0, x, 0, 0), 32, 1.0))


def test_an_origin_of_numpy_is_one():
    mesh = decode(EXAMPLES["std"])
    assert (mesh.positions_in_metres(np.array([1, 2, 3])) == mesh.positions_in_metres((1, 2, 3))).all()


@pytest.mark.parametrize("origin", [(0.5, 0, 0), (VOXELS_MAX + 1, 0, 0), (0, 0)])
def test_an_origin_that_is_no_point_is_refused(origin):
    with pytest.raises(ValueError, match="origin"):
        decode(EXAMPLES["std"]).positions_in_metres(origin)


@pytest.mark.parametrize("profile", ["std", "f32"])
def test_unit_normals(profile: str):
    normals = decode(EXAMPLES[profile]).unit_normals()
    assert normals.dtype == np.float32
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-6)
    assert normals == pytest.approx(np.array([[1, 4, 0]] * 4) / np.sqrt(17), abs=0.5 / 127)
