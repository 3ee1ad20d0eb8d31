"""The hash of lattice points: neighbours are independent, and no shift maps it onto itself."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.noise import lattice
from tests.noises import KEYS, keys_of
from tests.reference import field_oracle

AXES = lattice.AXIS_X, lattice.AXIS_Y, lattice.AXIS_Z
SIDE = 96
ORIGINS = [(0, 0, 0), (-48, -48, -48), (2**32 - 48, -(2**32) - 48, 5), (-(2**40), 3, 2**40)]
STEPS = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1), (2, 0, 0), (0, 0, 16)]


def cube(seed: int, splits: int) -> NDArray[np.uint32]:
    """Return the hashes of SIDE**3 lattice points from one of the origins on, with keys of that seed."""
    grid = [along(axis, SIDE) + low for axis, low in enumerate(ORIGINS[seed])]
    return field_oracle.corner_bits(grid, AXES, keys_of(seed), splits)


def along(axis: int, side: int) -> NDArray[np.int64]:
    """Return 0 to side - 1 along one of three axes."""
    shape = [1, 1, 1]
    shape[axis] = side
    return np.arange(side).reshape(shape)


def chi_square_sigmas(counts: NDArray[np.int64]) -> float:
    """Return how many standard deviations the chi-square of equal expectations lies above its mean."""
    expected, freedom = counts.mean(), counts.size - 1
    return float((((counts - expected) ** 2 / expected).sum() - freedom) / np.sqrt(2 * freedom))


def worst_pair(choice: NDArray[np.int64], choices: int) -> float:
    """Return the chi-square of pairs of equally likely choices along axes and diagonals, in standard deviations."""
    worst = 0.0
    for step in STEPS:
        ahead, behind = (tuple(slice(s, None) for s in step), tuple(slice(None, SIDE - s) for s in step))
        pairs = choices * choice[ahead] + choice[behind]
        worst = max(worst, chi_square_sigmas(np.bincount(pairs.ravel(), minlength=choices**2)))
    return worst


def test_neighbouring_corners_pick_independent_gradients():
    for seed in range(len(ORIGINS)):
        bits = cube(seed, splits=2)
        twelve = (4 * field_oracle.third(bits) + (bits >> np.uint32(30))).astype(np.int64)
        assert worst_pair(twelve, 12) < 8
        assert worst_pair((bits >> np.uint32(28)).astype(np.int64), 16) < 8


def test_squares_of_corners_have_no_parity():
    for seed in range(len(ORIGINS)):
        bits = cube(seed, splits=2)
        parity = bits[1:, 1:] ^ bits[1:, :-1] ^ bits[:-1, 1:] ^ bits[:-1, :-1]
        for bit in range(24, 32):
            assert chi_square_sigmas(np.bincount((parity >> np.uint32(bit) & np.uint32(1)).ravel())) < 8


def test_feature_points_are_anywhere_in_their_cell_whatever_their_value_and_their_neighbours():
    """In 4 * 4 * 4 parts of a cell, in 16 * 16 along two axes, with 16 parts of values; and pairs of neighbours."""
    for seed in range(len(ORIGINS)):
        bits = cube(seed, splits=1)
        at = field_oracle.shifts(bits.ravel()) + 0.5
        value = (field_oracle.values(field_oracle.feature_bits(bits.ravel())) + 1) / 2
        for columns, parts in (((0, 1, 2), 4), ((0, 1), 16), ((0, 2), 16), ((1, 2), 16)):
            assert chi_square_sigmas(joint([at[:, column] for column in columns], parts)) < 8
        for column in range(3):
            assert chi_square_sigmas(joint([at[:, column], value], 16)) < 8
            assert worst_pair((16 * at[:, column]).astype(np.int64).reshape(bits.shape), 16) < 8
        assert worst_pair((16 * value).astype(np.int64).reshape(bits.shape), 16) < 8


def joint(numbers: list[NDArray[np.float64]], parts: int) -> NDArray[np.int64]:
    """Count numbers in [0, 1) that fall into each of `parts` parts along each."""
    place = np.zeros(len(numbers[0]), np.int64)
    for number in numbers:
        place = place * parts + (number * parts).astype(np.int64)
    return np.bincount(place, minlength=parts ** len(numbers))


def test_hash_repeats_at_no_vector_that_a_linear_one_would_have():
    """A linear 32-bit hash of three axes repeats along some vector of about 1,600 cells: find it, and compare there."""
    reach = 900
    x, y, z = (np.arange(-reach, reach + 1, dtype=np.int64) * int(axis) for axis in AXES)
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
    here = field_oracle.corner_bits(corner, AXES, KEYS, splits=2)
    for vector in found[:20]:
        moved = [c + np.int64(v) for c, v in zip(corner, vector, strict=True)]
        assert (here == field_oracle.corner_bits(moved, AXES, KEYS, splits=2)).mean() < 0.01
