"""Which side of the surface a sample is on, and where the surface crosses an edge between two samples."""

from typing import Final

import numpy as np

from chunkserver.kernel import inlined

ISOVALUE: Final = np.float32(0)
"""Below is rock; exactly at it, or above, is air. `is_rock` has the only comparison."""


@inlined
def is_rock(density: np.float32) -> bool:
    """Return whether a sample is inside."""
    return bool(density < ISOVALUE)


@inlined
def crossing(low: np.float32, high: np.float32, units: int) -> int:
    """Return where the density crosses the isovalue between two corners, in lattice units, off both corners."""
    first, last = np.float64(low), np.float64(high)
    nearest = int(np.floor((np.float64(ISOVALUE) - first) / (last - first) * units + 0.5))
    return min(max(nearest, 1), units - 1)
