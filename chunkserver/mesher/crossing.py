"""Which side of the surface a sample is on, and where the surface crosses an edge between two samples."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined, lanes_below

ISOVALUE: Final = np.float32(0)
"""Below is rock; exactly at it, or above, is air. `is_rock` and `are_rock` have the mesher's only comparisons."""


@inlined
def is_rock(density: np.float32) -> bool:
    """Return whether a sample is inside."""
    return bool(density < ISOVALUE)


@inlined
def are_rock(densities: NDArray[np.float32], at: np.uint64) -> np.uint64:
    """Return which of `LANES` samples from index `at` on are inside: bit k for sample `at + k`. densities: flat."""
    return lanes_below(densities, at, ISOVALUE)


@inlined
def crossing(low: np.float32, high: np.float32, units: int) -> np.int32:
    """Return where the density crosses the isovalue between two corners, in lattice units, off both corners."""
    first, last = np.float64(low), np.float64(high)
    nearest = np.floor((np.float64(ISOVALUE) - first) / (last - first) * np.float64(units) + 0.5)
    return np.int32(min(max(nearest, 1.0), np.float64(units) - 1.0))
