"""The checks of surfaces see what is wrong: faults planted in a good mesh, and in the table that meshes come from."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.mesher.cases import loops
from chunkserver.mesher.cell import CUBE
from chunkserver.samples import Samples
from tests.property.test_neighbours import assert_seamless
from tests.reference.marching_cubes import cube_triangles, twin
from tests.surfaces import (
    Surface,
    as_manifold,
    assert_closed,
    assert_manifold,
    assert_no_degenerate,
    assert_watertight,
    weld,
    world_points,
)
from tests.worlds import SMALLEST, cut, grid_mesh, in_air, smooth, white_noise


def octahedron() -> Surface:
    """Return the surface of one sample of rock."""
    density = np.full((SMALLEST.samples,) * 3, 1, np.float32)
    density[9, 9, 9] = -1
    return weld([(ChunkKey(0, 0, 0, 0), grid_mesh(density))])


GOOD = octahedron()


def with_triangles(*triangles) -> Surface:
    return GOOD._replace(triangles=np.array(triangles, np.int64))


def joined(points: list[int]) -> Surface:
    """Return two octahedra of which these points of the second are the same as those of the first."""
    second = np.arange(6) + 6
    second[points] = points
    return GOOD._replace(
        points=np.concatenate([GOOD.points, GOOD.points + 5]),
        triangles=np.concatenate([GOOD.triangles, second[GOOD.triangles]]),
    )


def test_a_good_surface_passes():
    for check in (assert_closed, assert_manifold, assert_watertight, assert_no_degenerate):
        check(GOOD)
    assert as_manifold(GOOD).status().name == "NoError"
    assert as_manifold(GOOD).genus() == 0


@pytest.mark.parametrize("number", range(8))
def test_a_hole_is_seen(number):
    with pytest.raises(AssertionError, match="3 open edges"):
        assert_closed(with_triangles(*np.delete(GOOD.triangles, number, axis=0)))


@pytest.mark.parametrize("number", range(8))
def test_a_flipped_triangle_is_seen(number):
    triangles = GOOD.triangles.copy()
    triangles[number] = triangles[number, ::-1]
    with pytest.raises(AssertionError, match="3 open edges"):
        assert_closed(with_triangles(*triangles))
    assert as_manifold(with_triangles(*triangles)).status().name != "NoError"


def test_a_doubled_triangle_is_seen():
    with pytest.raises(AssertionError, match="3 open edges"):
        assert_closed(with_triangles(*GOOD.triangles, GOOD.triangles[0]))


def test_a_doubled_surface_is_seen():
    doubled = with_triangles(*GOOD.triangles, *GOOD.triangles)
    assert_closed(doubled)
    with pytest.raises(AssertionError, match="12 non-manifold edges"):
        assert_manifold(doubled)


def test_two_surfaces_that_share_an_edge_are_seen():
    both = joined(list(GOOD.triangles[0, :2]))
    assert_closed(both)
    with pytest.raises(AssertionError, match="1 non-manifold edges"):
        assert_manifold(both)


def test_two_surfaces_that_share_a_vertex_are_seen():
    with pytest.raises(AssertionError, match="carries 2 fans"):
        assert_manifold(joined([0]))
    assert_manifold(joined([]))


@pytest.mark.parametrize("points", [[0, 0, 1], [0, 1, 0], [2, 2, 2]])
def test_a_triangle_of_two_equal_corners_is_seen(points):
    with pytest.raises(AssertionError, match="1 degenerate"):
        assert_no_degenerate(with_triangles(*GOOD.triangles, points))


def test_a_triangle_without_area_is_seen():
    points = np.array([[0, 0, 0], [3, 6, 9], [5, 10, 15], [5, 10, 16]])
    flat = GOOD._replace(points=points, triangles=np.array([[0, 1, 2], [0, 1, 3]]))
    with pytest.raises(AssertionError, match="1 degenerate"):
        assert_no_degenerate(flat)


def test_an_open_border_is_no_fault_of_a_chunk_but_is_not_watertight(rng):
    surface = weld([(ChunkKey(0, 0, 0, 0), grid_mesh(smooth(rng, SMALLEST.samples)))])
    assert_manifold(surface)
    with pytest.raises(AssertionError, match="open edges"):
        assert_watertight(surface)


@pytest.mark.parametrize("by", [1, -1])
def test_a_vertex_off_by_one_unit_between_chunks_is_seen(by, rng):
    chunks = dict(cut(white_noise(rng, SMALLEST.samples + 16), 16))
    assert_closed(weld(chunks.items()))
    mesh = chunks[ChunkKey(0, 0, 0, 0)]
    on_face = np.flatnonzero(mesh.positions[:, 0] == 49152)
    positions = mesh.positions.copy()
    along = 1 if positions[on_face[0], 1] % 2048 else 2
    positions[on_face[0], along] = int(positions[on_face[0], along]) + by
    chunks[ChunkKey(0, 0, 0, 0)] = replace(mesh, positions=positions)
    with pytest.raises(AssertionError, match="open edges"):
        assert_closed(weld(chunks.items()))
    with pytest.raises(AssertionError):
        assert_seamless({key[1:]: chunk for key, chunk in chunks.items()})


@pytest.mark.parametrize("kind", ["int8", "float32"])
def test_a_normal_off_by_one_bit_between_chunks_is_seen(kind, rng):
    chunks = {key[1:]: mesh for key, mesh in cut(white_noise(rng, SMALLEST.samples + 16), 16, kind)}
    assert_seamless(chunks)
    mesh = chunks[0, 0, 0]
    normals = mesh.normals.copy()
    normals.view(np.uint8)[np.flatnonzero(mesh.positions[:, 1] == 49152)[0], 0] ^= 1
    with pytest.raises(AssertionError):
        assert_seamless({**chunks, (0, 0, 0): replace(mesh, normals=normals)})


def test_world_points_are_voxels():
    assert np.allclose(world_points(GOOD, 0, 16).mean(axis=0), 8)
    assert np.allclose(world_points(GOOD._replace(low=np.array([-1, 0, 2])), 3, 32).mean(axis=0), (-128, 128, 640))


def tabled(density, table) -> Surface:
    """Return the surface that the slow twin finds with another table."""
    found = twin(Samples(SMALLEST, density), table)
    points = np.array(list(found.vertices), np.int64) - 16384
    number = {place: i for i, place in enumerate(found.vertices)}
    triangles = np.array([[number[place] for place in triangle] for triangle in found.triangles])
    return Surface(points, triangles, np.zeros(3, np.int64), np.full(3, 1 << 15))


def fan(case):
    """Plain fans: some have a diagonal in a face."""
    return [(loop[0], a, b) for loop in loops(CUBE, case) for a, b in pairwise(loop[1:])]


def joined_the_other_way(case):
    """In cases of which only three corners are air, ambiguous faces join their inside corners."""
    if case.bit_count() != 5:
        return cube_triangles(case)
    return [(a, c, b) for a, b, c in cube_triangles(255 - case)]


def turned_over(case):
    """One case with its triangles the wrong way round."""
    return [(a, c, b) for a, b, c in cube_triangles(case)] if case == 23 else cube_triangles(case)


def short_of_one(case):
    """One case without its last triangle."""
    return cube_triangles(case)[:-1] if case == 200 else cube_triangles(case)


@pytest.mark.parametrize(
    ("table", "fault"),
    [(fan, "non-manifold"), (joined_the_other_way, "open"), (turned_over, "open"), (short_of_one, "open")],
)
def test_a_fault_in_the_table_is_seen(table, fault, rng):
    density = in_air(white_noise(rng, SMALLEST.samples))
    assert_watertight(tabled(density, cube_triangles))
    with pytest.raises(AssertionError, match=f"{fault} edges"):
        assert_manifold(tabled(density, table))
