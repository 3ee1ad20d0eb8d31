"""A carved ball is round at every level that can show it, however deep it is; edits leave no crack between levels."""

from collections.abc import Iterator

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit
from chunkserver.grid import POSITION_LOW, ChunkKey
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe, builtin
from tests.octrees import random_octree
from tests.scale import count
from tests.strokes import edited, field_of, no_bricks, place, random_stroke
from tests.surfaces import assert_closed, weld
from tests.worlds import keys

PLANE = WorldRecipe(0, builtin("plane"))
CELLS = 32
RADII = (6.0, 8.0, 13.7, 24.0, 32.0)
DEPTHS = (2, 20, 1_000, 60_000)
ANGLE_MAX = 5.0
"""Degrees."""
STEPS_FOR_ALL = 3.0
STEPS_FOR_MEDIAN = 2.0
STEPS_APART = 3.0
"""Of a vertex from any other surface: here from the plane."""


def ball_in_plane(center: tuple[float, ...], radius: float) -> Bricks:
    carve = {"op": "carve", "shape": "sphere", "center": list(center), "radius": radius}
    return no_bricks(lods=6, slots=1 << 13).apply([Edit.of([carve])], 1, field_of(PLANE))


def angles(bricks: Bricks, lod: int, center: tuple[float, ...], radius: float) -> Iterator[np.ndarray]:
    """Yield by how many degrees normals differ from those of the ball, of vertices that are far from the plane."""
    step = 1 << lod
    side = CELLS * step
    low = [int((at - radius) // side) for at in center]
    high = [int((at + radius) // side) + 1 for at in center]
    for key in keys(lod, place(low), place(high)):
        mesh = extract(edited(PLANE, bricks, key, CELLS), normals="float32")
        corner = np.array(key[1:], np.float64) * side
        points = (mesh.positions[:, :3].astype(np.float64) - POSITION_LOW) * (side / 32768) + corner
        apart = points[:, 1] < -STEPS_APART * step
        inward = np.array(center) - points[apart]
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        normals = mesh.normals[apart, :3].astype(np.float64)
        yield np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", inward, normals), -1, 1)))


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("radius", RADII)
def test_a_carved_ball_is_round(radius, depth, rng):
    center = tuple(float(at) for at in (rng.uniform(-99, 99), -depth, rng.uniform(-99, 99)))
    bricks = ball_in_plane(center, radius)
    looked_at = 0
    for lod in range(6):
        steps = radius / (1 << lod)
        if steps < STEPS_FOR_MEDIAN:
            continue
        found = np.concatenate(list(angles(bricks, lod, center, radius)))
        looked_at += len(found)
        if len(found):
            assert np.median(found) <= ANGLE_MAX
            if steps >= STEPS_FOR_ALL:
                assert found.max() <= ANGLE_MAX
    assert looked_at > 50


@pytest.mark.parametrize("world", ["terrain", "planet", "plane"])
def test_edits_leave_no_crack(world, rng):
    """Chunks of three levels, with strokes of all kinds across their borders, welded."""
    recipe = WorldRecipe(3, builtin(world))
    low = (-1, 2, -1) if world == "planet" else (-1, -1, -1)
    for _ in range(count(100)):
        tree = random_octree(rng, 3, 0.3, low)
        middle = [(at + 1) * 64.0 for at in low]
        strokes = [
            random_stroke(rng, tuple(np.array(middle) + rng.uniform(-40, 40, 3)), float(rng.uniform(3, 12)))
            for _ in range(40)
        ]
        bricks = no_bricks(lods=5).apply([Edit.of(strokes)], 1, field_of(recipe))
        plain, edits = (
            weld([(key, extract(edited(recipe, at, key, 16, tree.coarser(key)))) for key in sorted(tree.leaves)])
            for at in (no_bricks(), bricks)
        )
        assert_closed(edits)
        assert len(edits.triangles) != len(plain.triangles)


def test_chunks_agree_where_they_meet(rng):
    """Two chunks that share lattice points have the same densities there, edits included."""
    recipe = WorldRecipe(3, builtin("terrain"))
    strokes = [random_stroke(rng, tuple(rng.uniform(-30, 30, 3)), 9.0) for _ in range(30)]
    bricks = no_bricks(lods=4).apply([Edit.of(strokes)], 1, field_of(recipe))
    for lod in range(4):
        left, right = (edited(recipe, bricks, ChunkKey(lod, x, -1, 0)).density for x in (-1, 0))
        assert np.array_equal(left[:, :, -3:], right[:, :, :3])
