"""Triangles that may have become lines: at a border that does not move, in a skirt that is not drawn out."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined


@inlined
def has_three_places(positions: NDArray[np.uint16], triangles: NDArray[np.uint32], row: int) -> bool:
    """Return whether no two of a triangle's corners are at the same place. positions: (V, 4). triangles: (T, 3)."""
    for corner in range(3):
        a, b = triangles[row, corner], triangles[row, (corner + 1) % 3]
        if (
            positions[a, 0] == positions[b, 0]
            and positions[a, 1] == positions[b, 1]
            and positions[a, 2] == positions[b, 2]
        ):
            return False
    return True


@inlined
def has_area(positions: NDArray[np.uint16], triangles: NDArray[np.uint32], row: int) -> bool:
    """Return whether a triangle's corners do not lie on a line. positions: (V, 4). triangles: (T, 3)."""
    a, b, c = triangles[row, 0], triangles[row, 1], triangles[row, 2]
    for axis in range(3):
        after = (axis + 1) % 3
        ux, vx = int(positions[b, axis]) - int(positions[a, axis]), int(positions[c, axis]) - int(positions[a, axis])
        uy, vy = (
            int(positions[b, after]) - int(positions[a, after]),
            int(positions[c, after]) - int(positions[a, after]),
        )
        if ux * vy != uy * vx:
            return True
    return False
