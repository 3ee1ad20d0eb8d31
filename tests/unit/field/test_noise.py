"""Noise: bits against the plain twin, values against the definition, far away as at the origin."""

import numpy as np
import pytest

from chunkserver.field.noise import NOISES
from tests.noises import ALL, CONTINUOUS, KERNELS, SMOOTH, defined, draws, evaluate, twin
from tests.scale import count


def corners_and_ties(rng, n):
    """Points on corners, edges and faces of lattice cells of all noises, on diagonals, and one rounding away."""
    points = rng.integers(-24, 25, (n, 3)) / rng.choice([1.0, 2.0, 3.0, 6.0, 19.0], (n, 1))
    points[::3, 1] = points[::3, 0]
    points[::5, 2] = points[::5, 1]
    points[::7] = np.nextafter(points[::7], np.inf)
    return points


def test_each_noise_has_facts():
    assert {name.partition(" ")[0] for name in NOISES} == set(KERNELS)
    assert all(facts.dimensions == int(name.partition(" ")[0][-1]) for name, facts in NOISES.items())


@pytest.mark.parametrize("noise", ALL)
@pytest.mark.parametrize("extent", [2.0, 1e4, 2.0**33, 2.0**41])
def test_compiled_noise_is_its_plain_twin_bit_for_bit(noise, extent, rng):
    points = rng.uniform(-extent, extent, (count(20_000), 3))
    assert np.array_equal(evaluate(noise, points), twin(noise, points))


@pytest.mark.parametrize("noise", ALL)
def test_compiled_noise_is_its_plain_twin_on_corners_and_ties(noise, rng):
    points = corners_and_ties(rng, count(30_000))
    jitter = 0.0 if noise.startswith("cellular") else 1.0
    assert np.array_equal(evaluate(noise, points, jitter=jitter), twin(noise, points, jitter))


@pytest.mark.parametrize("noise", ALL)
def test_compiled_noise_is_its_plain_twin_where_the_low_word_of_a_coordinate_wraps(noise, rng):
    """Cells -4 to 4 from multiples of 2**32, where steps to other corners and cells carry into the high word."""
    page = rng.integers(-300, 300, (count(40_000), 3)) * 2.0**32
    points = page + rng.uniform(-4, 4, page.shape)
    assert np.array_equal(evaluate(noise, points), twin(noise, points))


@pytest.mark.parametrize("noise", [name for name in ALL if name.startswith("cellular")])
@pytest.mark.parametrize("jitter", [0.0, 0.37, 0.8])
def test_compiled_cellular_noise_is_its_plain_twin_at_any_jitter(noise, jitter, rng):
    points = rng.uniform(-99, 99, (count(10_000), 3))
    assert np.array_equal(evaluate(noise, points, jitter=jitter), twin(noise, points, jitter))


@pytest.mark.parametrize("noise", ALL)
@pytest.mark.parametrize("n", [1, 3, 255, 256, 257, 2 * 256 + 7])
def test_noise_of_a_point_does_not_depend_on_its_place_in_a_block(noise, n, rng):
    points = rng.uniform(-50, 50, (n, 3))
    one_by_one = np.concatenate([evaluate(noise, point[None]) for point in points])
    assert np.array_equal(evaluate(noise, points), one_by_one)


@pytest.mark.parametrize("noise", ALL)
@pytest.mark.parametrize(("width", "rows"), [(35, 35), (16, 5), (17, 300), (256, 3), (40, 1), (35, 1)])
@pytest.mark.parametrize("frequency", [0.05, 0.4, 3.7])
def test_noise_of_points_in_rows_is_that_of_the_points(noise, width, rows, frequency, rng):
    """Rows with the x of all others, in no order of z, and with a new y now and then."""
    x = np.tile(rng.uniform(-9, 9) + np.arange(width), rows)
    step = rng.choice([0, 1, 1, 1, 2, -7], rows).cumsum()
    y, z = (np.repeat(places, width) for places in (3.7 * (np.arange(rows) // 6), step - 4.2))
    points = np.stack([x, y, z], 1)
    in_rows = evaluate(noise, points, frequency=frequency, width=width)
    assert np.array_equal(in_rows, evaluate(noise, points, frequency=frequency))


@pytest.mark.parametrize("noise", ["gradient3", "value2", "simplex3"])
@pytest.mark.parametrize("far", [0.0, 2.0**32, -(2.0**34)])
def test_noise_of_points_in_rows_is_that_of_the_points_where_the_low_word_of_a_coordinate_wraps(noise, far):
    x, z = (axis.ravel() for axis in np.meshgrid(far + np.arange(-17, 18) / 4, np.arange(-17, 18) / 8 - far))
    points = np.stack([x, np.full(x.size, far), z], 1)
    assert np.array_equal(evaluate(noise, points, width=35), evaluate(noise, points))


@pytest.mark.parametrize("noise", ALL)
def test_noise_is_added_with_its_amplitude_and_frequency(noise, rng):
    points = rng.uniform(-9, 9, (300, 3))
    below = rng.normal(size=300).astype(np.float32)
    added = evaluate(noise, points, amplitude=0.75, frequency=2.0, below=below)
    assert np.array_equal(added, below + np.float32(0.75) * evaluate(noise, 2 * points))


@pytest.mark.parametrize("noise", [name for name in ALL if NOISES[name].dimensions == 2])
def test_noise_of_the_plane_does_not_read_y(noise, rng):
    points = rng.uniform(-9, 9, (300, 3))
    assert np.array_equal(evaluate(noise, points), evaluate(noise, points * [1, np.nan, 1]))


@pytest.mark.parametrize("noise", ALL)
@pytest.mark.parametrize("extent", [3.0, 1e3, 1e6])
def test_noise_is_what_defines_it(noise, extent, rng):
    """float32 against float64. The definition skews simplex noise in float64: at 1e6 it has lost 2**-32 of a cell."""
    for points in draws(rng, extent, count(500_000), chunk=25_000):
        expected, margin = defined(noise, points)
        clear = margin > 1e-6
        assert clear.mean() > 0.99
        assert np.abs(evaluate(noise, points) - expected)[clear].max() < 3e-6


@pytest.mark.parametrize("noise", ALL)
@pytest.mark.parametrize("far", [2**32, 2**36, -(2**36), 2**40 - 32])
def test_noise_is_what_defines_it_far_away(noise, far, rng):
    """Points that are exact there, to 2**-11 of a cell: the definition counts them from a whole cell."""
    cells = np.array([[far, -far - 5, far // 2 + 3]])
    points = rng.integers(-9 * 2**11, 9 * 2**11, (count(100_000), 3)) / 2**11
    expected, margin = defined(noise, points, cells)
    clear = margin > 1e-6
    assert clear.mean() > 0.99
    assert np.abs(evaluate(noise, cells + points) - expected)[clear].max() < 3e-6


@pytest.mark.parametrize("noise", CONTINUOUS)
@pytest.mark.parametrize("far", [0.0, -3.0, 2.0**32, -(2.0**36), 2.0**36])
def test_noise_is_as_smooth_far_away_as_at_the_origin(noise, far):
    """Steps of 1/1024 cell along axes and diagonals: no jump and, but for cellular noise, no kink (|n''| < 160)."""
    step = 1 / 1024
    line = np.arange(-8 * 1024, 8 * 1024)[:, None] * step
    for direction in [(1, 0, 0), (0, 0, 1), (1, 0, -1), (0, 1, 0), (1, -1, 1)]:
        if any(direction[axis] for axis in (0, 2)) or NOISES[noise].dimensions == 3:
            points = far * np.array([1, 1, -1]) + [0, 0.25, 0.375] + line * direction
            values = evaluate(noise, points).astype(np.float64)
            assert np.ptp(values) > 0.2, "the noise does vary along the line"
            assert np.abs(np.diff(values)).max() < NOISES[noise].lipschitz * np.sqrt(3) * step + 2e-6
            if noise in SMOOTH:
                assert np.abs(np.diff(values, 2)).max() < 160 * step**2 + 2e-6


@pytest.mark.parametrize("dimensions", [2, 3])
def test_cellular_value_is_that_of_the_cells_around_where_no_feature_point_is_near(dimensions, rng):
    points = rng.uniform(-1e3, 1e3, (count(10_000_000), 3))
    points = points[evaluate(f"cellular{dimensions} distance", points) == 1]
    assert len(points) > 10
    expected, _ = defined(f"cellular{dimensions} value", points, reach=1)
    assert np.abs(evaluate(f"cellular{dimensions} value", points) - expected).max() < 1e-6
