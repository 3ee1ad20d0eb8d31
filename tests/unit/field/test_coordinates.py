"""Points that are moved: exact where they can be, and as smooth far away as near the origin."""

import numpy as np
import pytest

from chunkserver.grid import ChunkKey, ChunkShape
from tests.unit.field.chunks import KEY, density, lattice

NOISE = {"op": "simplex3", "frequency": 0.07}
FLAT = {"op": "gradient2", "frequency": 0.07}
CELLULAR = {"op": "cellular3", "frequency": 0.07, "returns": "edge"}
CONE = {"op": "subtract", "a": {"op": "capsule", "a": [0, 0, 0], "b": [9, 20, 4], "radius": 3}, "b": NOISE}


@pytest.mark.parametrize("tree", [NOISE, FLAT, CELLULAR, CONE])
@pytest.mark.parametrize("key", [KEY, ChunkKey(0, 2**35, -(2**34), 5)])
def test_translate_by_whole_chunks_is_another_chunk(tree, key):
    moved = {"op": "translate", "a": tree, "offset": [32, -48, 16 * 2**20]}
    there = ChunkKey(0, key.x + 2, key.y - 3, key.z + 2**20)
    assert density(moved, there).tobytes() == density(tree, key).tobytes()


def test_translate_by_voxels_shifts_the_samples():
    moved = {"op": "translate", "a": CONE, "offset": [3, -1, 2]}
    assert density(moved)[:-1, 2:, 3:].tobytes() == density(CONE)[1:, :-2, :-3].tobytes()


@pytest.mark.parametrize("factor", [2, 0.5, 2.0**20])
def test_scale_by_powers_of_two_is_exact(factor):
    """Twice as large: every second sample is one of the original, and the density is twice it."""
    twice = density({"op": "scale", "a": CONE, "factor": 2}, ChunkKey(0, 0, 0, 0))
    assert np.array_equal(twice[1::2, 1::2, 1::2], 2 * density(CONE, ChunkKey(0, 0, 0, 0))[1:10, 1:10, 1:10])
    there_and_back = {"op": "scale", "a": {"op": "scale", "a": CONE, "factor": factor}, "factor": 1 / factor}
    assert np.array_equal(density(there_and_back), density(CONE))


def test_scale_takes_a_factor_for_each_axis_and_the_smallest_for_the_density():
    x, y, z = lattice()
    stretched = {"op": "scale", "a": {"op": "sphere", "radius": 2}, "factor": [3, 2, 5]}
    expected = 2 * (np.sqrt((x / 3) ** 2 + (y / 2) ** 2 + (z / 5) ** 2) - 2)
    assert np.abs(density(stretched) - expected).max() < 1e-5


def rotation(quaternion: list[float]) -> np.ndarray:
    """Return the matrix of a quaternion by turning each axis: v + 2 u x (u x v + w v)."""
    x, y, z, w = np.array(quaternion) / np.linalg.norm(quaternion)
    u = np.array([x, y, z])
    return np.stack([v + 2 * np.cross(u, np.cross(u, v) + w * v) for v in np.eye(3)], 1)


QUATERNIONS = [[0, 0, 0, 1], [0, 1, 0, 1], [1, 2, 3, 4], [-0.3, 0.1, 0.9, 0.2], [0, 0, 2.0**39, 0], [0, 0, 0, 2.0**-20]]


@pytest.mark.parametrize("quaternion", QUATERNIONS)
def test_rotate_turns_by_the_quaternion(quaternion):
    """A box that is turned is the box at points that are turned back."""
    extents = np.array([9.0, 4, 2])
    box = {"op": "box", "center": [0, 0, 0], "half_extents": extents.tolist()}
    points = np.stack(lattice(), -1) @ rotation(quaternion)
    away = np.abs(points) - extents
    expected = np.linalg.norm(np.maximum(away, 0), axis=-1) + np.minimum(away.max(-1), 0)
    assert np.abs(density({"op": "rotate", "a": box, "quaternion": quaternion}) - expected).max() < 1e-5


def test_a_quarter_turn_about_y_takes_z_to_x():
    """Right-handed: from z towards x."""
    x, _, _ = lattice()
    assert np.allclose(density({"op": "rotate", "a": {"op": "z"}, "quaternion": [0, 1, 0, 1]}), x, atol=1e-5)


REPEATED = {"op": "repeat", "a": CONE, "period": [16, 0, 32], "mean": 0}


def test_every_repeated_cell_is_the_same():
    here = density(REPEATED, ChunkKey(0, 0, 0, 0))
    for key in (ChunkKey(0, 1, 0, 2), ChunkKey(0, -7, 0, -4), ChunkKey(0, 2**35 + 1, 0, -(2**34))):
        assert density(REPEATED, key).tobytes() == here.tobytes()


def test_a_cell_is_the_subtree_around_the_origin():
    x, y, z = lattice()
    kept = {"op": "repeat", "a": CONE, "period": [2.0**30, 2.0**30, 0], "mean": 0}
    assert density(kept).tobytes() == density(CONE).tobytes()
    for axis in "xz":
        along = {"x": x, "z": z}[axis]
        period = {"x": 16, "z": 32}[axis]
        expected = along - period * np.floor(along / period + 0.5)
        assert np.array_equal(density({**REPEATED, "a": {"op": axis}}), expected)
    assert np.array_equal(density({**REPEATED, "a": {"op": "y"}}), y)


@pytest.mark.parametrize("period", [4.1, 10 / 3, 1000 / 7])
def test_what_is_no_power_of_two_stays_in_its_cell(period):
    """Far away too: no point is farther from its cell's middle than half a period, but for rounding."""
    period = max(period, 4.0)
    tree = {"op": "repeat", "a": {"op": "x"}, "period": [period, 0, 0], "mean": 0}
    for key in (KEY, ChunkKey(0, 2**36 - 1, 0, 0)):
        assert np.abs(density(tree, key)).max() <= period / 2 + 1e-3


def test_random_is_one_number_for_each_cell():
    cells = density({"op": "repeat", "a": {"op": "random"}, "period": [8, 8, 8], "mean": 0}, shape=ChunkShape(64))
    x, y, z = (np.floor(c / 8 + 0.5).astype(int) for c in lattice(shape=ChunkShape(64)))
    names = (x - x.min()) + 100 * (y - y.min()) + 10_000 * (z - z.min())
    found = [np.unique(cells[names == name]) for name in np.unique(names)]
    assert all(len(values) == 1 for values in found)
    values = np.concatenate(found)
    assert len(np.unique(values)) == len(values) > 500
    assert np.abs(values).max() <= 1
    assert abs(values.mean()) < 4 / np.sqrt(3 * len(values))


def test_random_is_told_apart_by_salt_and_seed_and_outside_a_repetition_it_is_one_number():
    world = density({"op": "random"})
    assert len(np.unique(world)) == 1
    assert density({"op": "random", "salt": 1})[0, 0, 0] != world[0, 0, 0]
    assert np.array_equal(density({"op": "random"}, ChunkKey(0, 9, 9, 9)), world)


def test_random_is_of_the_innermost_repetition():
    """The outer one's cells do not tell its inner cells apart."""
    inner = {"op": "repeat", "a": {"op": "random"}, "period": [8, 0, 0], "mean": 0}
    outer = {"op": "repeat", "a": inner, "period": [32, 0, 32], "mean": 0}
    assert density(outer).tobytes() == density(outer, ChunkKey(0, KEY.x + 2, 0, KEY.z - 4)).tobytes()


def test_warp_by_nothing_is_nothing():
    for still in ({}, {"x": 0}, {"x": 0, "y": 0, "z": 0}):
        assert density({"op": "warp", "a": CONE, **still}).tobytes() == density(CONE).tobytes()
    zero = {"op": "multiply", "a": {"op": "x"}, "b": 0}
    assert density({"op": "warp", "a": CONE, "x": zero, "y": zero}).tobytes() == density(CONE).tobytes()


def test_warp_looks_up_at_moved_points():
    x, y, z = lattice()
    by = {"x": {"op": "multiply", "a": {"op": "z"}, "b": 0.25}, "y": 3, "z": {"op": "y"}}
    for axis, expected in {"x": x + z / 4, "y": y + 3, "z": z + y}.items():
        assert np.array_equal(density({"op": "warp", "a": {"op": axis}, **by}), expected)


def test_moves_apply_from_the_outside_in():
    """p is first shifted back by 10, then halved: a(p / 2 - 5)."""
    x, _, _ = lattice()
    tree = {"op": "translate", "a": {"op": "scale", "a": {"op": "x"}, "factor": 2}, "offset": [10, 0, 0]}
    assert np.array_equal(density(tree), 2 * ((x - 10) / 2))


SMOOTH = {"op": "simplex3", "frequency": 1 / 64}
SWAY = {"op": "multiply", "a": {"op": "simplex3", "frequency": 1 / 64, "salt": 1}, "b": 8}
TURN = [0.1, 0.2, 0.3, 0.9]
FAR = 2.0**36


def at_far(tree: object, far: float) -> np.ndarray:
    """Return a chunk of a tree that was moved away by `far` along each axis, there: 24 voxels high."""
    chunk = int(far) // 32
    moved = {"op": "translate", "a": {"op": "multiply", "a": tree, "b": 24}, "offset": [far, -far, far]}
    return density(moved, ChunkKey(0, chunk, -chunk, chunk), ChunkShape(32)).astype(np.float64)


@pytest.mark.parametrize(
    "tree",
    [
        SMOOTH,
        {"op": "warp", "a": SMOOTH, "x": SWAY, "y": SWAY, "z": 1.5},
        {"op": "rotate", "a": SMOOTH, "quaternion": TURN},
        {"op": "rotate", "a": {"op": "warp", "a": SMOOTH, "x": SWAY}, "quaternion": TURN},
    ],
)
def test_what_is_moved_far_away_is_what_it_was(tree):
    assert np.array_equal(at_far(tree, FAR), at_far(tree, 0.0))


@pytest.mark.parametrize(
    "tree",
    [
        {"op": "warp", "a": SMOOTH, "x": SWAY, "y": SWAY, "z": 1.5},
        {"op": "rotate", "a": SMOOTH, "quaternion": TURN},
        {"op": "rotate", "a": {"op": "warp", "a": SMOOTH, "x": SWAY}, "quaternion": TURN},
        {"op": "scale", "a": {"op": "simplex3", "frequency": 3 / 64}, "factor": 3},
    ],
)
def test_noise_is_as_smooth_far_away_under_warp_and_rotation(tree):
    """Noise 24 voxels high, at 2^36 voxels from the origin. What rounding adds shows in third differences, which are
    at most 8 times it, and tiny where a function is smooth: they are no larger there than near the origin, but for
    the roughness of 1/1024 voxel."""
    rough = []
    for chunk in (0, int(FAR) // 32):
        raised = {"op": "multiply", "a": tree, "b": 24}
        got = density(raised, ChunkKey(0, chunk, -chunk, chunk), ChunkShape(32)).astype(np.float64)
        assert np.ptp(got) > 1, "the noise does vary over the chunk"
        rough.append(max(np.abs(np.diff(got, 5, axis)).max() for axis in range(3)))
    near, far = rough
    assert far < 4 * near + 1 / 1024
