"""One mesh out of many chunks, by exact equality of lattice points, and its open edges."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

PACKED_BITS: Final = 63
"""Bits of the three coordinates of a point together: they sort as one int64."""


def weld(points: Integers) -> tuple[Integers, Integers]:
    """Return the distinct points, (W, 3), and which of them each point is, (V,).

    points: (V, 3) on one lattice, V at least 1. Raises `ValueError` if they lie too far apart for one int64 each.
    """
    low = points.min(axis=0)
    bits = [int(extent).bit_length() for extent in points.max(axis=0) - low]
    if sum(bits) > PACKED_BITS:
        raise ValueError(f"points as far apart as {bits} bits of lattice units: at most {PACKED_BITS} together")
    shifts = np.array([0, bits[0], bits[0] + bits[1]])
    packed, number = np.unique((points - low) @ (1 << shifts), return_inverse=True)
    return (packed[:, None] >> shifts & (1 << np.array(bits)) - 1) + low, np.asarray(number, np.int64)


def edges(triangles: Integers) -> tuple[Integers, Integers]:
    """Return the edges, (E, 2) with the lower vertex first, and how much oftener they are walked so than back, (E,).

    triangles: (T, 3). In a closed surface the balance of every edge is 0: elsewhere it has a rim.
    """
    walked = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    low, high = walked.min(axis=1), walked.max(axis=1)
    vertices = int(high.max(initial=0)) + 1
    packed, number = np.unique(low * vertices + high, return_inverse=True)
    balance = np.bincount(number, np.where(walked[:, 0] == low, 1, -1), len(packed))
    return np.stack(np.divmod(packed, vertices), axis=1), balance.astype(np.int64)
