"""Deltas of coarser levels: filtered by 1 2 1 along each axis, so that what is thin fades with everything else."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import kernel

_Ints = NDArray[np.int32]


def halve(fine: _Ints) -> _Ints:
    """Return the deltas of a box of the next level.

    fine: (2 y + 1, 2 z + 1, 2 x + 1) int32, C order, units: what is around them too, `Box.finer`.

    Returns (y, z, x) int32: of each the 27 products with weights 1 2 1 of each axis, summed exactly, then rounded:
    (sum + 32) >> 6.
    """
    planes, rows, width = fine.shape
    coarse = np.empty((planes // 2, rows // 2, width // 2), np.int32)
    _halve(fine.reshape(-1), rows, width, np.empty(width, np.int64), coarse.reshape(-1))
    return coarse


@kernel
def _halve(fine: _Ints, rows: int, width: int, sums: NDArray[np.int64], coarse: _Ints) -> None:
    """sums: (width,) scratch."""
    two, one = np.uint64(2), np.uint64(1)
    row, plane = np.uint64(width), np.uint64(rows) * np.uint64(width)
    across, deep = row // two, np.uint64(rows) // two
    for to in range(np.uint64(coarse.size) // across):
        a = two * (to // deep) * plane + two * (to % deep) * row
        b, c = a + plane, a + two * plane
        for i in range(row):
            low = np.int64(fine[a + i]) + 2 * np.int64(fine[a + row + i]) + np.int64(fine[a + two * row + i])
            middle = np.int64(fine[b + i]) + 2 * np.int64(fine[b + row + i]) + np.int64(fine[b + two * row + i])
            high = np.int64(fine[c + i]) + 2 * np.int64(fine[c + row + i]) + np.int64(fine[c + two * row + i])
            sums[i] = low + 2 * middle + high
        for i in range(across):
            total = sums[two * i] + 2 * sums[two * i + one] + sums[two * i + two]
            coarse[to * across + i] = np.int32((total + 32) >> 6)
