"""Where vertices come to lie, what counts as rock, and which way normals point: on grids that can be read."""

import numpy as np
import pytest

from chunkserver.grid import CELLS_BUILT, POSITION_LOW, ChunkShape
from chunkserver.mesh import EMPTY, NormalKind, index_type
from chunkserver.mesher import extract
from chunkserver.samples import Samples
from tests.surfaces import assert_no_degenerate, assert_watertight, weld
from tests.worlds import GRIDS, SMALLEST, grid_mesh, one_chunk, white_noise

AXES = [("x", 2), ("y", 0), ("z", 1)]
"""Axes and their place in an array of samples."""


def layers(cells, axis, low, high):
    """Return samples that are `low` up to a plane in the middle of the chunk and `high` beyond."""
    side = ChunkShape(cells).samples
    row = np.where(np.arange(side) <= side // 2, low, high).astype(np.float32)
    return np.ascontiguousarray(np.broadcast_to(np.expand_dims(row, [a for a in range(3) if a != axis]), (side,) * 3))


def crossing(cells, axis, low, high):
    """Return how far along its edge, in lattice units, the surface between two layers lies."""
    shape = ChunkShape(cells)
    mesh = grid_mesh(layers(cells, axis, low, high))
    place = {2: 0, 0: 1, 1: 2}[axis]
    (found,) = set(mesh.positions[:, place].tolist())
    return found - POSITION_LOW - (shape.samples // 2 - shape.apron) * shape.units_per_cell


@pytest.mark.parametrize(("name", "axis"), AXES)
@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_a_crossing_is_rounded_half_up(cells, name, axis):
    units = ChunkShape(cells).units_per_cell
    assert units == {16: 2048, 32: 1024, 64: 512}[cells]
    for part, expected in (
        (units // 2, units // 2),
        (3.0, 3),
        (3.25, 3),
        (3.5, 4),
        (4.5, 5),
        (3.75, 4),
        (units - 2.5, units - 2),
    ):
        assert crossing(cells, axis, -part, units - part) == expected, name
        assert crossing(cells, axis, part, part - units) == expected, "from air to rock"


@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_a_crossing_stays_off_both_corners(cells):
    units, tiny = ChunkShape(cells).units_per_cell, 1e-45
    for low, high in ((-tiny, 65536.0), (-1e-6, 1.0), (0.0, -1.0), (-0.0, -1.0), (tiny, -65536.0), (-1.0, 65536.0)):
        assert crossing(cells, 0, low, high) == 1
    for low, high in ((-65536.0, tiny), (-1.0, 0.0), (-1.0, -0.0), (1.0, -1e-6), (65536.0, -1.0)):
        assert crossing(cells, 0, low, high) == units - 1


def test_crossings_between_the_smallest_numbers():
    assert crossing(32, 1, -1e-45, 1e-45) == 512
    assert crossing(32, 1, -3e-45, 1e-45) == 683


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_a_sample_at_the_isovalue_is_air(zero, rng):
    everywhere = np.full((SMALLEST.samples,) * 3, zero, np.float32)
    assert grid_mesh(everywhere) is EMPTY["air"]
    rock = everywhere - 1
    assert grid_mesh(rock) is EMPTY["rock"]
    rock[9, 9, 9] = zero
    assert len(grid_mesh(rock).triangles) == 8, "a bubble of one sample"
    noise = white_noise(rng, SMALLEST.samples)
    noise[noise > 0] = zero
    assert np.array_equal(grid_mesh(noise).triangles, grid_mesh(np.where(noise < 0, noise, 1)).triangles)


def test_samples_of_the_apron_alone_make_no_surface():
    density = np.full((SMALLEST.samples,) * 3, 1, np.float32)
    density[0], density[:, -1], density[:, :, 0] = -1, -1, -1
    assert grid_mesh(density) is EMPTY["air"]
    assert grid_mesh(-density) is EMPTY["rock"]


@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("kind", GRIDS)
def test_one_vertex_a_crossed_edge_inside_that_edge(cells, kind, rng):
    shape = ChunkShape(cells)
    density = GRIDS[kind](rng, shape.samples)
    mesh = grid_mesh(density)
    cell, inside_cell = np.divmod(mesh.positions[:, :3].astype(int) - POSITION_LOW, shape.units_per_cell)
    assert ((inside_cell != 0).sum(axis=1) == 1).all(), "strictly inside one edge: never on a corner"
    rock = density[1:-1, 1:-1, 1:-1] < 0
    crossed = sum(np.count_nonzero(np.diff(rock, axis=axis)) for axis in range(3))
    assert len(np.unique(mesh.positions.view(np.uint64))) == len(mesh.positions) == crossed
    axis = inside_cell.argmax(axis=1)
    ends = [rock[place[:, 1], place[:, 2], place[:, 0]] for place in (cell, cell + np.eye(3, dtype=int)[axis])]
    assert (ends[0] != ends[1]).all()
    assert np.array_equal(np.unique(mesh.triangles), np.arange(crossed)), "no vertex without a triangle"


def test_arrays_are_the_wires_own(rng):
    kinds: list[tuple[NormalKind, int]] = [("int8", 4), ("float32", 3)]
    for kind, width in kinds:
        mesh = grid_mesh(white_noise(rng, SMALLEST.samples), kind)
        arrays = (mesh.positions, mesh.normals, mesh.triangles)
        assert mesh.content == "surface"
        assert not mesh.is_empty
        assert [array.dtype for array in arrays] == [np.dtype(of) for of in ("uint16", kind, "uint16")]
        assert [array.shape[1] for array in arrays] == [4, width, 3]
        assert len(mesh.positions) == len(mesh.normals)
        assert all(array.flags.c_contiguous for array in arrays)
        assert (mesh.positions[:, 3] == 65535).all()


@pytest.mark.parametrize(("name", "axis"), AXES)
@pytest.mark.parametrize("sense", [1, -1])
def test_normals_and_triangles_face_the_air(name, axis, sense):
    mesh = grid_mesh(layers(16, axis, -sense, sense))
    towards = np.zeros(4, np.int8)
    towards["xyz".index(name)] = 127 * sense
    assert (mesh.normals == towards).all()
    a, b, c = (mesh.positions[mesh.triangles[:, i], :3].astype(int) for i in range(3))
    assert (np.sign(np.cross(b - a, c - a)) == np.sign(towards[:3])).all()


@pytest.mark.parametrize(("name", "axis"), AXES)
@pytest.mark.parametrize("sense", [1, -1])
def test_a_zero_gradient_gives_the_direction_of_the_edge_towards_air(name, axis, sense):
    """One sample of another sign: the differences at both ends of an edge cancel along it, and are zero across it."""
    density = layers(16, axis, -sense, -sense)
    density = np.where(np.indices(density.shape)[axis] % 2 == 0, density, -density)
    mesh = grid_mesh(density, "float32")
    assert len(mesh.positions) == 16 * 17 * 17
    along, others = mesh.normals[:, "xyz".index(name)], np.delete(mesh.normals, "xyz".index(name), axis=1)
    assert (others == 0).all()
    cell = (mesh.positions[:, "xyz".index(name)].astype(int) - POSITION_LOW) // SMALLEST.units_per_cell
    starts_in_rock = (np.where((cell + 1) % 2 == 0, -sense, sense)) < 0
    assert np.array_equal(along, np.where(starts_in_rock, 1, -1))


def test_normals_are_rounded_half_up():
    """A plane whose normal is (1, 0, 254) / length: 127 times its x component is close to one half."""
    y, z, x = np.indices((SMALLEST.samples,) * 3)
    for tilt, expected in ((0.9, 0), (1.1, 1), (-0.9, 0), (-1.1, -1)):
        density = (tilt * x / 254 + z - 9.5 - tilt * 0.04 + 0 * y).astype(np.float32)
        assert set(grid_mesh(density).normals[:, 0].tolist()) == {expected}
    exact = grid_mesh((z - 9.5).astype(np.float32), "float32").normals
    assert np.array_equal(np.unique(exact, axis=0), [[0, 0, 1]])


def test_float32_normals_have_unit_length(rng):
    for make in GRIDS.values():
        normals = grid_mesh(make(rng, SMALLEST.samples), "float32").normals.astype(np.float64)
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-7


def test_the_same_samples_give_the_same_mesh_and_stay_as_they_were(rng):
    density = white_noise(rng, SMALLEST.samples)
    before = density.copy()
    first, second = (extract(Samples(SMALLEST, density)) for _ in range(2))
    assert np.array_equal(density, before)
    for name in ("positions", "normals", "triangles"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_a_single_sample_of_rock_is_an_octahedron():
    density = np.full((SMALLEST.samples,) * 3, 1, np.float32)
    density[9, 10, 11] = -3
    mesh = grid_mesh(density)
    corner = POSITION_LOW + 2048 * np.array([10, 8, 9])
    away = mesh.positions[:, :3].astype(int) - corner
    assert sorted(away.tolist()) == sorted(
        (sense * 1536 * np.eye(3, dtype=int)[a]).tolist() for a in range(3) for sense in (1, -1)
    )
    surface = weld(one_chunk(density))
    assert len(mesh.triangles) == 8
    assert_watertight(surface)
    assert_no_degenerate(surface)


@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_indices_are_as_wide_as_they_have_to_be(cells, rng):
    """64 cells of white noise have more vertices than 16 bits number."""
    shape = ChunkShape(cells)
    mesh = extract(Samples(shape, rng.standard_normal((shape.samples,) * 3).astype(np.float32)))
    vertices = len(mesh.positions)
    assert mesh.triangles.dtype == index_type(vertices) == (np.uint32 if cells == 64 else np.uint16)
    assert np.array_equal(np.unique(mesh.triangles), np.arange(vertices))


@pytest.mark.parametrize(("ends", "dtype"), [(3, np.uint16), (4, np.uint32)])
def test_the_last_mesh_of_16_bits_and_the_first_of_32(ends, dtype):
    """Rock that touches no other has six vertices a sample, but in a corner or on an edge of the chunk."""
    shape, single = ChunkShape(64), 10_922
    density = np.ones((shape.samples,) * 3, np.float32)
    inner = density[shape.apron : -shape.apron, shape.apron : -shape.apron, shape.apron : -shape.apron]
    places = np.indices((31, 31, 31)).reshape(3, -1)[:, :single] * 2 + 2
    inner[tuple(places)] = -1
    inner[(0, 0, 0) if ends == 3 else (0, 0, 2)] = -1
    mesh = extract(Samples(shape, density))
    assert (len(mesh.positions), mesh.triangles.dtype) == (6 * single + ends, dtype)
    assert np.array_equal(np.unique(mesh.triangles), np.arange(6 * single + ends))
    corners = mesh.positions.astype(int)[mesh.triangles, :3]
    assert np.ptp(corners, axis=1).max() <= shape.units_per_cell
    assert len(mesh.triangles) == 8 * single + (1 if ends == 3 else 2)
