"""Noise: bits against the plain twin, values against the definition, and what noise promises as a random function."""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.field import noise
from chunkserver.field.noise import gradient, lattice, simplex
from chunkserver.field.tape import noise_name
from chunkserver.recipe.library import CAVE_FREQUENCY, CAVE_SCALE, CAVE_THRESHOLD
from tests.reference import field_oracle, noise_twin
from tests.scale import count

BASES: Final = ("gradient2", "simplex3")
OFFSETS, KEYS = noise_name(7, 0, 0)


def evaluate(
    basis: str,
    points: NDArray[np.float64],
    name: tuple[int, int, int] | None = None,
    frequency: float = 1.0,
    keys: Sequence[int] = KEYS,
) -> NDArray[np.float32]:
    """Run a compiled noise at points (n, 3): that named (seed, salt, octave), or that of `keys` without offset."""
    offsets: Sequence[float] = (0.0, 0.0, 0.0)
    if name:
        offsets, keys = noise_name(*name)
    x, y, z = np.ascontiguousarray(points.T)
    numbers = np.array([1.0, frequency, *offsets])
    below, out = np.zeros(len(points), np.float32), np.empty(len(points), np.float32)
    rest = (numbers, np.array(keys, np.uint32), below, out, *noise.scratch())
    if basis == "gradient2":
        noise.add_gradient2(x, y, z, *rest)
    else:
        noise.add_simplex3(x, y, z, *rest)
    return out


def twin(basis: str, points: NDArray[np.float64]) -> NDArray[np.float32]:
    if basis == "gradient2":
        return np.array([noise_twin.gradient2(x, y, z, KEYS) for x, y, z in points], np.float32)
    return np.array([noise_twin.simplex3(x, y, z, KEYS) for x, y, z in points], np.float32)


def corners_and_ties(rng, n):
    """Points on corners, edges and faces of lattice cells of both noises, on diagonals, and one rounding away."""
    points = rng.integers(-12, 13, (n, 3)) / rng.choice([1.0, 2.0, 3.0, 6.0], (n, 1))
    points[::3, 1] = points[::3, 0]
    points[::5, 2] = points[::5, 1]
    points[::7] = np.nextafter(points[::7], np.inf)
    return points


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("extent", [2.0, 1e4, 2.0**33, 2.0**41])
def test_compiled_noise_is_its_plain_twin_bit_for_bit(basis, extent, rng):
    points = rng.uniform(-extent, extent, (count(30_000), 3))
    assert np.array_equal(evaluate(basis, points), twin(basis, points))


@pytest.mark.parametrize("basis", BASES)
def test_compiled_noise_is_its_plain_twin_on_corners_and_ties(basis, rng):
    points = corners_and_ties(rng, count(40_000))
    assert np.array_equal(evaluate(basis, points), twin(basis, points))


@pytest.mark.parametrize("basis", BASES)
def test_compiled_noise_is_its_plain_twin_where_the_low_word_of_a_coordinate_wraps(basis, rng):
    """Cells -4 to 4 from multiples of 2**32, where `up`, the walk and the far corners carry into the high word."""
    page = rng.integers(-300, 300, (count(60_000), 3)) * 2.0**32
    points = page + rng.uniform(-4, 4, page.shape)
    assert np.array_equal(evaluate(basis, points), twin(basis, points))


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("n", [1, 3, 255, 256, 257, 2 * 256 + 7])
def test_noise_of_a_point_does_not_depend_on_its_place_in_a_block(basis, n, rng):
    points = rng.uniform(-50, 50, (n, 3))
    one_by_one = np.concatenate([evaluate(basis, point[None]) for point in points])
    assert np.array_equal(evaluate(basis, points), one_by_one)


@pytest.mark.parametrize("basis", BASES)
def test_noise_is_added_with_its_amplitude(basis, rng):
    points = rng.uniform(-9, 9, (300, 3))
    x, y, z = np.ascontiguousarray(points.T)
    below, out = rng.normal(size=300).astype(np.float32), np.empty(300, np.float32)
    rest = (np.array([0.75, 1, 0, 0, 0.0]), np.array(KEYS, np.uint32), below, out, *noise.scratch())
    noise.add_gradient2(x, y, z, *rest) if basis == "gradient2" else noise.add_simplex3(x, y, z, *rest)
    assert np.array_equal(out, below + np.float32(0.75) * evaluate(basis, points))


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("extent", [3.0, 1e3, 1e6])
def test_noise_is_the_sum_over_corners_that_defines_it(basis, extent, rng):
    """float32 against float64. The definition skews in float64: at 1e6 it has lost 2**-32 of a cell."""
    points = rng.uniform(-extent, extent, (count(2_000_000), 3))
    defined = getattr(field_oracle, basis)(points, KEYS)
    assert np.abs(evaluate(basis, points) - defined).max() < 3e-6


@pytest.mark.parametrize("basis", BASES)
def test_noise_stays_in_its_range_and_fills_it(basis, rng):
    most = 0.0
    for extent in (4.0, 1e3, 1e9, 2.0**40):
        values = evaluate(basis, rng.uniform(-extent, extent, (count(25_000_000), 3)))
        assert np.abs(values).max() <= 1
        most = max(most, float(np.abs(values).max()))
    assert most > 0.9


def test_supremum_of_simplex_noise_is_what_its_scale_says(rng):
    """Each corner with the best of its twelve gradients: the two largest components of the way to it, added up."""
    corners = np.array([[0, 0, 0], [5 / 6, -1 / 6, -1 / 6], [2 / 3, 2 / 3, -1 / 3], [1 / 2, 1 / 2, 1 / 2]])

    def best(points):
        away = points[:, None, :] - corners
        kernel = np.maximum(float(simplex.REACH) - (away**2).sum(2), 0) ** 4
        by_size = np.sort(np.abs(away), axis=2)
        return (kernel * (by_size[:, :, 1] + by_size[:, :, 2])).sum(1)

    supremum = climb(best, rng.dirichlet(np.ones(4), 20_000) @ corners, rng)
    assert 0.998 < supremum * float(simplex.SIMPLEX3_SCALE) < 1


def test_supremum_of_gradient_noise_is_what_its_scale_says(rng):
    angles = np.arange(1, 32, 2) * np.pi / 16
    gradients = np.stack([np.cos(angles), np.sin(angles)], 1)

    def best(points):
        points = np.clip(points, 0, 1)
        total = np.zeros(len(points))
        for corner in itertools.product((0, 1), repeat=2):
            near = 1 - np.abs(points - corner)
            weight = (near**3 * (near * (6 * near - 15) + 10)).prod(1)
            total += weight * ((points - corner) @ gradients.T).max(1)
        return total

    supremum = climb(best, rng.uniform(0, 1, (20_000, 2)), rng)
    assert 0.998 < supremum * float(gradient.GRADIENT2_SCALE) < 1


def climb(function, points, rng) -> float:
    """Return the largest value found from the best 100 points by ever smaller random steps."""
    for step in 0.1 * 0.7 ** np.arange(40):
        points = points[np.argsort(-function(points))[:100]]
        points = np.concatenate([points, np.repeat(points, 10, 0) + rng.normal(0, step, (1000, points.shape[1]))])
    return float(function(points).max())


@pytest.mark.parametrize("basis", BASES)
def test_mean_of_noise_is_zero(basis, rng):
    values = evaluate(basis, rng.uniform(-1e6, 1e6, (count(50_000_000), 3)))
    assert abs(values.mean(dtype=np.float64)) < 5 * values.std() / np.sqrt(values.size)


@pytest.mark.parametrize("basis", BASES)
def test_seeds_salts_and_octaves_are_uncorrelated(basis, rng):
    points = rng.uniform(-1e4, 1e4, (count(20_000_000), 3))
    names = [(7, 0, 0), (8, 0, 0), (-7, 0, 0), (7 + 2**32, 0, 0), (7, 1, 0), (7, 0, 1), (7, 0, 2), (-(2**63), 0, 0)]
    correlation = np.corrcoef([evaluate(basis, points, name) for name in names]) - np.eye(len(names))
    assert np.abs(correlation).max() < 5.5 / np.sqrt(len(points))


@pytest.mark.parametrize("basis", BASES)
def test_noise_around_the_origin_is_like_noise_elsewhere(basis, rng):
    """Over many seeds, without offsets: mean 0 and the same spread in all eight octants and far away.

    The places are apart by vectors that shift both lattices onto themselves: whole, with a sum that 3 divides.
    """
    seeds = 400
    at = rng.uniform(0, 1, (200, 3))
    places = [np.array(corner, float) for corner in itertools.product((-3, 0), repeat=3)]
    values = [
        [evaluate(basis, at + place, keys=noise_name(seed, 0, 0)[1]) for seed in range(seeds)]
        for place in [*places, np.full(3, -1e6), np.full(3, 2.0**36)]
    ]
    mean, spread = np.mean(values, axis=1), np.std(values, axis=1)
    assert np.abs(mean).max() < 6 * spread.max() / np.sqrt(seeds)
    typical = spread.mean(axis=0)
    assert np.abs(spread / typical - 1).max() < 6 / np.sqrt(2 * seeds)


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("far", [0.0, -3.0, 2.0**32, -(2.0**36), 2.0**36])
def test_noise_is_as_smooth_far_away_as_at_the_origin(basis, far):
    """Steps of 1/1024 cell along a diagonal of 16 cells: no jump, no kink. There |n'| < 10 and |n''| < 120."""
    step = 1 / 1024
    line = far + np.arange(-8 * 1024, 8 * 1024) * step
    points = np.stack([line, np.full_like(line, far + 0.25), 0.375 - line], 1)
    values = evaluate(basis, points).astype(np.float64)
    assert np.abs(np.diff(values)).max() < 10 * step
    assert np.abs(np.diff(values, 2)).max() < 120 * step**2 + 1e-6


def test_neighbouring_corners_pick_independent_gradients():
    """Chi-square of pairs of gradients along axes and diagonals, and the parity of squares, on 96**3 corners."""
    side = 96
    worst = 0.0
    for seed, origin in enumerate([(0, 0, 0), (-48, -48, -48), (2**32 - 48, -(2**32) - 48, 5), (-(2**40), 3, 2**40)]):
        grid = [
            (np.arange(side) + low).reshape(shape)
            for low, shape in zip(origin, np.eye(3, dtype=int) * (side - 1) + 1, strict=True)
        ]
        bits = field_oracle.corner_bits(grid, field_axes(), noise_name(seed, 0, 0)[1], splits=2)
        gradient = (4 * field_oracle.third(bits) + (bits >> np.uint32(30))).astype(np.int64)
        for step in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1), (2, 0, 0), (0, 0, 16)]:
            ahead, behind = (tuple(slice(s, None) for s in step), tuple(slice(None, side - s) for s in step))
            pairs = np.bincount((12 * gradient[ahead] + gradient[behind]).ravel(), minlength=144)
            worst = max(worst, chi_square_sigmas(pairs))
        parity = bits[1:, 1:] ^ bits[1:, :-1] ^ bits[:-1, 1:] ^ bits[:-1, :-1]
        for bit in range(24, 32):
            worst = max(worst, chi_square_sigmas(np.bincount((parity >> np.uint32(bit) & np.uint32(1)).ravel())))
    assert worst < 8


def along(axis: int, side: int) -> NDArray[np.int64]:
    """Return 0 to side - 1 along one of three axes."""
    shape = [1, 1, 1]
    shape[axis] = side
    return np.arange(side).reshape(shape)


def field_axes() -> tuple[np.uint32, np.uint32, np.uint32]:
    return lattice.AXIS_X, lattice.AXIS_Y, lattice.AXIS_Z


def chi_square_sigmas(counts: NDArray[np.int64]) -> float:
    """Return how many standard deviations the chi-square of equal expectations lies above its mean."""
    expected, freedom = counts.mean(), counts.size - 1
    return float((((counts - expected) ** 2 / expected).sum() - freedom) / np.sqrt(2 * freedom))


def test_noise_repeats_at_no_vector_that_a_linear_hash_would_have():
    """A linear 32-bit hash of three axes repeats along some vector of about 1,600 cells: find it, and compare there."""
    reach = 900
    x, y, z = (np.arange(-reach, reach + 1, dtype=np.int64) * int(axis) for axis in field_axes())
    plane = ((x[:, None] + y[None, :]) % 2**32).ravel()
    order = np.argsort(plane)
    at = np.searchsorted(plane[order], -z % 2**32) % plane.size
    found = [
        (i // x.size - reach, i % x.size - reach, k - reach)
        for k, i in enumerate(order[at])
        if (plane[i] + z[k]) % 2**32 == 0 and k != reach
    ]
    assert found, "the search itself works: a linear hash does repeat"
    corner = [along(axis, 64) for axis in range(3)]
    here = field_oracle.corner_bits(corner, field_axes(), KEYS, splits=2)
    for vector in found[:20]:
        there = field_oracle.corner_bits(
            [c + np.int64(v) for c, v in zip(corner, vector, strict=True)], field_axes(), KEYS, splits=2
        )
        assert (here == there).mean() < 0.01


def test_gradient_of_the_caves_is_about_one_per_voxel_at_their_surface(rng):
    """The mean over the surface, by area: CAVE_SCALE makes a stroke's strength mean voxels."""
    points = rng.uniform(-1e5, 1e5, (count(100_000_000), 3))
    near = np.abs(evaluate("simplex3", points, frequency=CAVE_FREQUENCY) - CAVE_THRESHOLD) < 0.02
    points = points[near]
    slopes = []
    for axis in range(3):
        side = np.eye(3)[axis] / 4
        above, below = (evaluate("simplex3", points + s, frequency=CAVE_FREQUENCY) for s in (side, -side))
        slopes.append(CAVE_SCALE * (above - below) / 0.5)
    gradient = np.sqrt(np.square(slopes).sum(0, dtype=np.float64))
    assert 0.95 < (gradient**2).sum() / gradient.sum() < 1.1
