"""Deltas of bricks added to a chunk's samples.

A box lies in a grid of bricks. Of each of these a kernel gets the slot, or NONE where all deltas are 0:

    slots     ( 7    NONE   9  )        place: where the first brick begins, counted
              +------+------+------+    from the first point of the box, so never above 0
              |    ######## |      |
              +------+------+------+
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_DELTAS, NONE, Holds
from chunkserver.edits.boxes import Place
from chunkserver.edits.strokes import UNITS_PER_VOXEL
from chunkserver.kernel import choose, inlined, kernel

VOXELS_PER_UNIT: Final = 1.0 / UNITS_PER_VOXEL
FLOAT32_INT_MAX: Final = 1 << 24
"""Up to here all integers are float32."""
_STEP: Final = np.float32(VOXELS_PER_UNIT)

_Ints = NDArray[np.int32]


class Reading(NamedTuple):
    """The bricks that meet a box of lattice points: plain values, cheap to send to another process.

    slots: (y, z, x) int32, C order: of each brick, or NONE. place: x, y, z of the first brick, in points of the box.
    low, high: what the deltas of the box lie between, units; both are 0 where there is no brick at all.
    held: the bricks stay where they are for as long as this is kept; nothing in another process.
    """

    slots: _Ints
    place: Place
    low: int
    high: int
    held: Holds | tuple[()] = ()


def apply(density: NDArray[np.float32], arena: _Ints, reading: Reading) -> None:
    """Add the deltas of a box to its densities: float32(float64(density) + delta / 1024).

    density: (y, z, x) float32, C order, voxels, in and out: what the field has at the box's level.
    arena: (slots, BRICK_DELTAS) int32, C order: where the bricks lie.
    """
    if max(-reading.low, reading.high) > FLOAT32_INT_MAX:
        density[:] = density.astype(np.float64) + _gathered(arena, reading, density.shape) * VOXELS_PER_UNIT
    elif reading.low or reading.high:
        bricks = arena.reshape(-1).view()
        bricks.flags.writeable = False  # as it is where another process writes them: the same compiled code
        _add(bricks, reading.slots, *reading.place, density)


def _gathered(arena: _Ints, reading: Reading, shape: tuple[int, ...]) -> _Ints:
    """Return the deltas of a box: (y, z, x) int32."""
    slots = reading.slots
    found = np.where(slots[..., None] == NONE, 0, arena[np.maximum(slots, 0)])
    cubes = found.reshape(*slots.shape, BRICK, BRICK, BRICK).transpose(0, 3, 1, 4, 2, 5)
    x, y, z = (-at for at in reading.place)
    planes, rows, width = shape
    return cubes.reshape([BRICK * count for count in slots.shape])[y : y + planes, z : z + rows, x : x + width]


@inlined
def _apart(brick: int, rows: int, width: int) -> tuple[int, int, int]:
    """Return y, z, x of a brick of the grid."""
    return brick // (rows * width), brick // width % rows, brick % width


@inlined
def _span(place: int, brick: int, count: int) -> tuple[int, int, int]:
    """Return where a brick begins along an axis, and its first point and one past its last one in the box."""
    start = place + brick * BRICK
    return start, choose(start > 0, start, 0), choose(start + BRICK < count, start + BRICK, count)


@kernel
def _add(arena: _Ints, slots: _Ints, px: int, py: int, pz: int, density: NDArray[np.float32]) -> None:
    """Add deltas that are float32 exactly. Then sums rounded to float64 and to float32 are sums rounded to float32."""
    planes, rows, width = density.shape
    points = density.reshape(-1)
    for brick in range(slots.size):
        b, c, d = _apart(brick, slots.shape[1], slots.shape[2])
        slot = np.int64(slots[b, c, d])
        if slot != NONE:
            y, y0, y1 = _span(py, b, planes)
            z, z0, z1 = _span(pz, c, rows)
            x, x0, x1 = _span(px, d, width)
            for j in range(y0, y1):
                at = np.uint64(slot * BRICK_DELTAS + ((j - y) * BRICK + z0 - z) * BRICK + x0 - x)
                to = np.uint64((j * rows + z0) * width + x0)
                for _ in range(z0, z1):
                    for i in range(np.uint64(x1 - x0)):
                        points[to + i] += np.float32(arena[at + i]) * _STEP
                    at, to = at + np.uint64(BRICK), to + np.uint64(width)
