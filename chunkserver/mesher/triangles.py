"""Triangles whose corners may have come together: at a border that does not move, in a skirt that is not drawn out."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined


@inlined
def has_three_places(positions: NDArray[np.uint16], triangle: NDArray[np.uint32]) -> bool:
    """Return whether no two of a triangle's corners are at the same place. positions: (V, 4). triangle: (3,)."""
    for corner in range(3):
        a, b = triangle[corner], triangle[corner - 1]
        if (
            positions[a, 0] == positions[b, 0]
            and positions[a, 1] == positions[b, 1]
            and positions[a, 2] == positions[b, 2]
        ):
            return False
    return True
