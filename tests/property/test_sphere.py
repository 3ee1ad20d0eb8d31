"""The built-in sphere against the ball that it is, put together from its chunks: where a figure can be exact."""

import numpy as np
import pytest

from chunkserver.grid import CELLS_BUILT, ChunkKey
from chunkserver.mesh import NormalKind
from chunkserver.recipe import WorldRecipe, builtin
from tests.surfaces import as_manifold, assert_no_degenerate, assert_watertight, volume, weld, world_points
from tests.worlds import box_of_chunks, chunk_mesh, keys

RADIUS = 48.0
VOLUME_ERROR_MAX = 0.005
RADIUS_ERROR_MAX = 0.02
"""Voxels."""
NORMAL_ERROR_MAX = 2.0
"""Degrees."""

SPHERE = WorldRecipe(0, builtin("sphere"))


def corners(cells: int) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    side = -int(-(RADIUS + 1) // cells)
    return (-side,) * 3, (side,) * 3


@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_a_closed_ball_of_the_right_size(cells):
    surface = weld(box_of_chunks(SPHERE, 0, *corners(cells), cells))
    assert_watertight(surface)
    assert_no_degenerate(surface)
    manifold = as_manifold(surface)
    assert manifold.status().name == "NoError"
    assert manifold.genus() == 0
    unit = cells / (1 << 15)
    exact = 4 / 3 * np.pi * RADIUS**3
    assert volume(surface) * unit**3 == pytest.approx(exact, rel=VOLUME_ERROR_MAX)
    assert manifold.volume() * unit**3 == pytest.approx(exact, rel=VOLUME_ERROR_MAX)
    radii = np.linalg.norm(world_points(surface, 0, cells), axis=1)
    assert np.abs(radii - RADIUS).max() <= RADIUS_ERROR_MAX


@pytest.mark.parametrize("normals", ["int8", "float32"])
@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_normals_point_away_from_the_middle(cells, normals: NormalKind):
    worst = 0.0
    for key in keys(0, *corners(cells)):
        mesh = chunk_mesh(SPHERE, key, cells, normals)
        points = (mesh.positions[:, :3].astype(float) - 16384) * cells / 32768 + np.array(key[1:]) * cells
        exact = points / np.linalg.norm(points, axis=1, keepdims=True)
        found = mesh.normals[:, :3].astype(float)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", exact, found).min(initial=1)
        worst = max(worst, float(np.degrees(np.arccos(min(cosine, 1.0)))))
    assert worst <= NORMAL_ERROR_MAX


@pytest.mark.parametrize("lod", [1, 2, 3, 4, 12, 15, 16, 17, 20])
def test_a_larger_sphere_at_a_coarser_level_is_the_same_mesh(lod):
    """Twice the radius at twice the step: powers of two change no bit."""
    larger = WorldRecipe(0, builtin("sphere", radius=RADIUS * 2**lod))
    for key in keys(0, (-1, 0, 1), (1, 2, 2)):
        fine, coarse = chunk_mesh(SPHERE, key), chunk_mesh(larger, ChunkKey(lod, *key[1:]))
        assert np.array_equal(fine.positions, coarse.positions)
        assert np.array_equal(fine.normals, coarse.normals)
        assert np.array_equal(fine.triangles, coarse.triangles)


@pytest.mark.parametrize(("radius", "lod"), [(200.0, 2), (200.0, 4), (6400.0, 7), (6.4e6, 16)])
def test_caves_that_a_level_cannot_show_leave_no_trace(radius, lod):
    """A planet without relief, seen from far away, is the ball: the cave term must not bend what it does not cut."""
    planet = WorldRecipe(0, builtin("planet", radius=radius, relief=0.0))
    ball = WorldRecipe(0, builtin("sphere", radius=radius))
    side = 32 << lod
    for key in (ChunkKey(lod, int(radius // side), 0, 0), ChunkKey(lod, -1, int(-radius // side), 0)):
        seen, exact = chunk_mesh(planet, key), chunk_mesh(ball, key)
        assert not exact.is_empty
        assert np.array_equal(seen.positions, exact.positions)
        assert np.array_equal(seen.normals, exact.normals)
