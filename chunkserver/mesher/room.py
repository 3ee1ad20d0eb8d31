"""Room for transition cells: what is less than a cell from a masked face is squeezed towards the chunk's inside.

**A vertex that touches a face of the chunk that is not masked does not move**: so neighbours that know nothing of this
border still fit, and two masked faces of different chunks meet in a line.
"""

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver.kernel import inlined, kernel

_Places = NDArray[np.uint16]


@kernel
def make_room(positions: _Places, mask: int, units: int) -> None:
    """Move every vertex of the regular mesh that is in the way. positions: (V, 4). units: a cell."""
    low, high = POSITION_LOW + units, POSITION_HIGH - units
    for vertex in range(positions.shape[0]):
        x, y, z = np.int64(positions[vertex, 0]), np.int64(positions[vertex, 1]), np.int64(positions[vertex, 2])
        if min(x, y, z) < low or max(x, y, z) > high:
            move(positions, vertex, mask, units)


@inlined
def move(positions: _Places, vertex: int, mask: int, units: int) -> None:
    """Move a vertex away from the masked faces that it is near: d < 1 cell becomes d + (1 - d) / 4, rounded half up."""
    if _is_held(positions, vertex, mask):
        return
    for axis in range(3):
        place = int(np.int64(positions[vertex, axis]))
        low, high = place - POSITION_LOW, POSITION_HIGH - place
        if low < units and mask >> (2 * axis) & 1:
            positions[vertex, axis] = POSITION_LOW + _squeezed(low, units)
        elif high < units and mask >> (2 * axis + 1) & 1:
            positions[vertex, axis] = POSITION_HIGH - _squeezed(high, units)


@inlined
def _is_held(positions: _Places, vertex: int, mask: int) -> bool:
    """Return whether a vertex touches a face that is not masked."""
    for axis in range(3):
        place = positions[vertex, axis]
        if place == POSITION_LOW and not mask >> (2 * axis) & 1:
            return True
        if place == POSITION_HIGH and not mask >> (2 * axis + 1) & 1:
            return True
    return False


@inlined
def _squeezed(distance: int, units: int) -> int:
    return (3 * distance + units + 2) >> 2
