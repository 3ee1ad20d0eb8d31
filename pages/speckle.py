"""Value noise in numpy: what gives pictures their grain and clouds. No part of any world."""

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]

PRIMES: Final = np.array([73856093, 19349663, 83492791])


def noise(points: Vectors) -> Vectors:
    """Return value noise, -1 to 1, of points (..., 3): one lattice cell per unit, the same in every picture."""
    cell = np.floor(points)
    t = points - cell
    t = t * t * (3 - 2 * t)
    whole = cell.astype(np.int64)
    total = np.zeros(points.shape[:-1])
    for corner in product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, t, 1 - t), axis=-1)
        total += weight * hashed(whole + corner)
    return total


def hashed(cells: NDArray[np.int64]) -> Vectors:
    """Return -1 to 1 for each cell (..., 3), without pattern."""
    mixed = (cells @ PRIMES).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return np.asarray((mixed >> np.uint64(40)) / float(1 << 23) - 1)
