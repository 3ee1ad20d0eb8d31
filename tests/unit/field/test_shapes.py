"""Distances against their formulas in numpy's float64, near and far; and what makes them distances."""

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.grid import ChunkKey, ChunkShape
from tests.unit.field.chunks import KEY, Axes, density, lattice

Distances = NDArray[np.float64]

SPHERE = {"op": "sphere", "center": [1.5, -2, 30], "radius": 9.25}
BOX = {"op": "box", "center": [-7.5, 3, 20], "half_extents": [5, 3.25, 9], "rounding": 0}
CAPSULE = {"op": "capsule", "a": [-12, 3, 17], "b": [2, 11.5, 29], "radius": 2.5}
TORUS = {"op": "torus", "center": [-8, 5, 24], "radius": 6.5, "tube": 2}
CYLINDER = {"op": "cylinder", "center": [-8, 5, 24], "radius": 3.5, "half_height": 4.25}
PLANE = {"op": "plane", "normal": [1, 2, -2], "offset": -11.5}


def norm(*parts: Distances) -> Distances:
    return np.asarray(np.linalg.norm(np.stack(parts), axis=0))


def sphere(at: Axes) -> Distances:
    x, y, z = at
    return norm(x - 1.5, y + 2, z - 30) - 9.25


def box(at: Axes) -> Distances:
    """Clamp the point to the box; inside, the nearest of the six faces."""
    low, high = np.array([-12.5, -0.25, 11]), np.array([-2.5, 6.25, 29])
    points = np.stack(at, -1)
    outside = np.linalg.norm(points - np.clip(points, low, high), axis=-1)
    faces = np.min(np.concatenate([points - low, high - points], -1), axis=-1)
    return np.asarray(np.where(outside > 0, outside, -np.maximum(faces, 0)))


def capsule(at: Axes) -> Distances:
    a, b = np.array([-12.0, 3, 17]), np.array([2, 11.5, 29])
    points = np.stack(at, -1)
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.asarray(np.linalg.norm(points - (a + t[..., None] * (b - a)), axis=-1)) - 2.5


def torus(at: Axes) -> Distances:
    """The distance to the nearest point of the ring, by its direction from the middle."""
    x, y, z = at
    angle = np.arctan2(z - 24, x + 8)
    return norm(x + 8 - 6.5 * np.cos(angle), y - 5, z - 24 - 6.5 * np.sin(angle)) - 2


def cylinder(at: Axes) -> Distances:
    x, y, z = at
    across, up = norm(x + 8, z - 24) - 3.5, np.abs(y - 5) - 4.25
    outside = norm(np.maximum(across, 0), np.maximum(up, 0))
    return np.asarray(np.where(outside > 0, outside, np.maximum(across, up)))


def plane(at: Axes) -> Distances:
    x, y, z = at
    return (x + 2 * y - 2 * z) / 3 + 11.5


SHAPES = [(SPHERE, sphere), (BOX, box), (CAPSULE, capsule), (TORUS, torus), (CYLINDER, cylinder), (PLANE, plane)]
IDS = ["sphere", "box", "capsule", "torus", "cylinder", "plane"]


@pytest.mark.parametrize(("tree", "exact"), SHAPES, ids=IDS)
def test_a_distance_is_its_formula(tree, exact):
    """Within a rounding of float32, which is all that a distance has: near the surface it is nearly exact."""
    got, expected = density(tree), exact(lattice())
    assert (np.abs(got - expected) <= 2.0**-24 * np.abs(expected) + 1e-13).all()
    assert got.min() < 0 < got.max(), "the chunk does hold the surface"


@pytest.mark.parametrize(("tree", "exact"), SHAPES, ids=IDS)
def test_a_distance_is_as_exact_far_away(tree, exact):
    far = [2.0**36, -(2.0**37), 2.0**35]
    moved = {"op": "translate", "a": tree, "offset": far}
    key = ChunkKey(0, KEY.x + 2**32, KEY.y - 2**33, KEY.z + 2**31)
    assert np.array_equal(density(moved, key), density(tree))
    assert np.abs(density(moved, key) - exact(lattice())).max() < 1 / 1024


@pytest.mark.parametrize(("tree", "_exact"), SHAPES, ids=IDS)
def test_a_distance_changes_by_at_most_as_much_as_the_point_moves(tree, _exact):
    """The intervals build on that. Along each axis and each diagonal."""
    got = density(tree).astype(np.float64)
    for steps in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1)]:
        moved = got[tuple(slice(step, None) for step in steps)]
        change = np.abs(moved - got[tuple(slice(None, -step or None) for step in steps)])
        assert change.max() <= np.sqrt(sum(steps)) + 1e-5


def test_a_rounded_box_lies_in_the_box():
    """Its flat faces are the box's; its corners lie inside. Rounded fully, it is a sphere."""
    whole, rounded = density(BOX), density({**BOX, "rounding": 2})
    assert (rounded >= whole).all()
    x, _, z = lattice()
    middle = (x == -8) & (z == 20)
    assert np.array_equal(rounded[middle], whole[middle])
    ball = {"op": "box", "center": SPHERE["center"], "half_extents": [9.25] * 3, "rounding": 9.25}
    assert np.allclose(density(ball), density(SPHERE), atol=1e-6)


def test_degenerate_shapes():
    """A capsule of no length is a sphere; a normal may have any length."""
    dot = {"op": "capsule", "a": SPHERE["center"], "b": SPHERE["center"], "radius": 9.25}
    assert np.array_equal(density(dot), density(SPHERE))
    for length in (2.0**-19, 2.0**38):
        assert np.allclose(density({**PLANE, "normal": [length, 2 * length, -2 * length]}), density(PLANE), atol=1e-5)


def planet_keys() -> list[ChunkKey]:
    """Return chunks on a sphere of radius 6.4 million voxels: poles, equator, and Pythagorean places in between."""
    radius = 6_400_000 // 32
    places = [
        *((1, 0, 0), (0, 1, 0), (0, 0, -1), (-1, 0, 0), (0, -1, 0)),
        *((3 / 5, 4 / 5, 0), (-4 / 5, 0, 3 / 5), (0, 7 / 25, -24 / 25), (2 / 3, 2 / 3, 1 / 3), (-2 / 7, 3 / 7, 6 / 7)),
    ]
    return [ChunkKey(0, *(int(np.floor(radius * part)) for part in place)) for place in places]


@pytest.mark.parametrize("key", planet_keys())
def test_a_sphere_of_the_size_of_the_earth_is_round(key):
    """Within 1/1024 voxel of the exact distance, worked out in integers: (d - r)(d + r) = d^2 - r^2."""
    radius, shape = 6_400_000, ChunkShape(32)
    got = density({"op": "sphere", "radius": radius}, key, shape)
    x, y, z = (c.astype(np.int64) for c in lattice(key, shape))
    square = x * x + y * y + z * z
    exact = (square - radius * radius) / (np.sqrt(square.astype(np.longdouble)) + radius)
    assert np.abs(exact).min() < 1, "the chunk does hold the surface"
    assert np.abs(got - exact).max() < 1 / 1024


def test_a_shape_is_as_round_when_it_is_moved_and_scaled_there():
    """A unit sphere made as large as the Earth, within 1/1024 voxel: the scale is worked out in float32 once."""
    key = ChunkKey(0, 6_400_000 * 3 // 5 // 32, 6_400_000 * 4 // 5 // 32, -1)
    scaled = {"op": "scale", "a": {"op": "sphere", "radius": 1000}, "factor": 6400}
    got, plain = density(scaled, key), density({"op": "sphere", "radius": 6_400_000}, key)
    assert np.abs(got - plain).max() < 1 / 1024
