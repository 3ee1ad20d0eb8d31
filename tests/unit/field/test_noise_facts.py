"""The table of facts: each bound is kept, and none is larger than it has to be.

Where noise is largest, and where it is steepest, depends on a point, a direction and the gradients or values at a few
corners. For each point and direction the worst of these are found one by one, since noise is their sum; the rest is a
search that climbs.
"""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.field.noise import NOISES, gradient
from chunkserver.field.noise.simplex2 import SIMPLEX2_SCALE
from chunkserver.field.noise.simplex3 import SIMPLEX3_SCALE
from tests.noises import ALL, CONTINUOUS, climb, draws, evaluate
from tests.scale import count

Doubles = NDArray[np.float64]
Term = tuple[Doubles, Doubles]
"""The weight (n,) of a corner at points, and its gradient (n, d)."""

ANGLES = np.arange(1, 32, 2) * np.pi / 16
COMPASS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1)
SIGNS = list(itertools.product((-1, 1), repeat=2))
GOLDEN = (1 + 5**0.5) / 2
ICOSAHEDRON = np.array([np.roll([0, a, b * GOLDEN], k) for a, b in SIGNS for k in range(3)])
EDGES = np.array([np.roll([0, a, b], k) for a, b in SIGNS for k in range(3)], float)

CUBE = {d: np.array(list(itertools.product((0.0, 1.0), repeat=d))) for d in (2, 3)}
TRIANGLE = np.array([[0, 0], [15, -4], [11, 11]]) / 19
TETRAHEDRON = np.array([[0, 0, 0], [2, 0, 0], [1, 1, 1], [1, 1, -1]]) / 2

SCALE = {
    "gradient2": gradient.GRADIENT2_SCALE,
    "gradient3": gradient.GRADIENT3_SCALE,
    "simplex2": SIMPLEX2_SCALE,
    "simplex3": SIMPLEX3_SCALE,
}
GRADIENTS = {"gradient2": COMPASS, "gradient3": ICOSAHEDRON, "simplex2": COMPASS, "simplex3": EDGES}
CORNERS = {
    **{name: CUBE[int(name[-1])] for name in ("gradient2", "gradient3", "value2", "value3")},
    "simplex2": TRIANGLE,
    "simplex3": TETRAHEDRON,
}
JITTERED = [
    *((noise, 1.0) for noise in ALL),
    *((noise, jitter) for noise in ALL if noise not in CORNERS for jitter in (0.0, 0.25, 0.5, 0.75)),
]


def quintic_weight(points: Doubles, corner: Doubles) -> Term:
    near = 1 - np.abs(points - corner)
    along = near**3 * (near * (6 * near - 15) + 10)
    slope = np.where(corner == 1, 1, -1) * 30 * near**2 * (1 - near) ** 2
    others = [np.delete(along, axis, 1).prod(1) for axis in range(points.shape[1])]
    return along.prod(1), slope * np.stack(others, 1)


def round_weight(points: Doubles, corner: Doubles) -> Term:
    away = points - corner
    left = np.maximum(0.5 - (away**2).sum(1), 0)
    return left**4, -8 * (left**3)[:, None] * away


def terms(noise: str, points: Doubles):
    """Yield the way from each corner of a noise to the points, and the corner's weight and the weight's gradient."""
    for corner in CORNERS[noise]:
        yield points - corner, *(round_weight if noise.startswith("simplex") else quintic_weight)(points, corner)


def inside(noise: str, points: Doubles) -> Doubles:
    return points if noise.startswith("simplex") else np.clip(points, 0, 1)


def largest(noise: str) -> Callable[[Doubles], Doubles]:
    """Return the function of points (n, d) that gives the largest value there: the best gradient at each corner."""

    def values(points: Doubles) -> Doubles:
        total = np.zeros(len(points))
        for away, weight, _ in terms(noise, inside(noise, points)):
            total += (away @ GRADIENTS[noise].T).max(1) * weight
        return total

    return values


def steepest(noise: str) -> Callable[[Doubles], Doubles]:
    """Return the function of points and directions (n, 2 * d) that gives the largest slope there, unscaled."""
    d = NOISES[noise].dimensions

    def slopes(placed: Doubles) -> Doubles:
        direction = placed[:, d:] / np.linalg.norm(placed[:, d:], axis=1, keepdims=True)
        total = np.zeros(len(placed))
        for away, weight, slope in terms(noise, inside(noise, placed[:, :d])):
            change = (slope * direction).sum(1)
            if noise.startswith("value"):
                total += np.abs(change)
            else:
                total += ((away * change[:, None] + direction * weight[:, None]) @ GRADIENTS[noise].T).max(1)
        return total

    return slopes


def starts(noise: str, rng: np.random.Generator, n: int) -> Doubles:
    corners = CORNERS[noise]
    spread: Doubles = rng.dirichlet(np.ones(len(corners)), n) @ corners
    return spread


@pytest.mark.parametrize("noise", SCALE)
def test_supremum_of_noise_is_what_its_scale_says(noise, rng):
    supremum = climb(largest(noise), starts(noise, rng, 20_000), rng) * float(SCALE[noise])
    assert 0.998 < supremum < 1


@pytest.mark.parametrize("noise", CORNERS)
def test_supremum_of_the_slope_is_what_the_facts_say(noise, rng):
    points = starts(noise, rng, 20_000)
    placed = np.concatenate([points, rng.normal(size=points.shape)], 1)
    supremum = climb(steepest(noise), placed, rng) * float(SCALE.get(noise, 1))
    assert 0.995 < supremum / NOISES[noise].lipschitz < 1 + 1e-9


@pytest.mark.parametrize("noise", CONTINUOUS)
def test_noise_is_no_steeper_than_the_facts_say(noise, rng):
    """Pairs of points 0.002 to 2 cells apart, in any direction."""
    dimensions, most = NOISES[noise].dimensions, 0.0
    for points in draws(rng, 1e3, count(100_000_000)):
        way = rng.normal(size=points.shape)
        way[:, 1] *= dimensions == 3
        way *= (2 * 10 ** rng.uniform(-3, 0, len(points)) / np.linalg.norm(way, axis=1))[:, None]
        change = np.abs(evaluate(noise, points + way).astype(np.float64) - evaluate(noise, points))
        slope = (change - 2e-6) / np.linalg.norm(way, axis=1)
        most = max(most, float(slope.max()))
    assert 0.5 < most / NOISES[noise].lipschitz <= 1


@pytest.mark.parametrize(("noise", "jitter"), JITTERED)
def test_noise_stays_in_its_range_and_fills_it(noise, jitter, rng):
    facts = NOISES[noise]
    low, high = np.inf, -np.inf
    for extent in (4.0, 1e3, 1e9, 2.0**40):
        for points in draws(rng, extent, count(25_000_000)):
            values = evaluate(noise, points, jitter=jitter)
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    assert facts.low <= low
    assert high <= facts.high
    filled = 0.85 if jitter == 1 else 0.7  # of 25,000,000 points 0.9; a hundredth of them may miss the ends
    assert high - low > filled * (facts.high - facts.low)


@pytest.mark.parametrize(("noise", "jitter"), JITTERED)
def test_means_are_what_the_facts_say(noise, jitter, rng):
    """Where a mean is 0, to five standard errors; that of a distance to 0.003, which is how well its formula fits."""
    facts = NOISES[noise]
    total, squares, absolute, n = 0.0, 0.0, 0.0, 0
    for points in draws(rng, 1e6, count(100_000_000)):
        values = evaluate(noise, points, jitter=jitter).astype(np.float64)
        total, squares, absolute = total + values.sum(), squares + (values**2).sum(), absolute + np.abs(values).sum()
        n += len(points)
    error = 5 * np.sqrt(squares / n / n)
    assert abs(total / n - facts.mean_at(jitter)) < error + (0.003 if facts.mean else 0)
    assert facts.mean or abs(absolute / n - facts.mean_absolute) < error + 2e-4
