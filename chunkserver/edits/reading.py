"""Bricks and dense boxes of lattice points: deltas copied from one to the other, or added to a chunk's samples.

A box lies in a grid of bricks. Of each of these a kernel gets the slot, or NONE where all deltas are 0:

    slots     ( 7    NONE   9  )        place: where the first brick begins, counted
              +------+------+------+    from the first point of the box, so never above 0
              |    ######## |      |
              +------+------+------+
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_DELTAS
from chunkserver.edits.boxes import Place
from chunkserver.edits.strokes import UNITS_PER_VOXEL
from chunkserver.kernel import choose, inlined, kernel

NONE: Final = -1
"""Stands for the slot of a brick that is not there."""
VOXELS_PER_UNIT: Final = 1.0 / UNITS_PER_VOXEL

_Ints = NDArray[np.int32]


class Reading(NamedTuple):
    """The bricks that meet a box of lattice points: plain values, cheap to send to another process.

    slots: (y, z, x) int32, C order: of each brick, or NONE. place: x, y, z of the first brick, in points of the box.
    low, high: what the deltas of the box lie between, units; both are 0 where there is no brick at all.
    """

    slots: _Ints
    place: Place
    low: int
    high: int


def apply(density: NDArray[np.float32], arena: _Ints, reading: Reading) -> None:
    """Add the deltas of a box to its densities: float32(float64(density) + delta / 1024).

    density: (y, z, x) float32, C order, voxels, in and out: what the field has at the box's level.
    arena: (slots, BRICK_DELTAS) int32, C order: where the bricks lie.
    """
    if reading.low or reading.high:
        bricks = arena.reshape(-1).view()
        bricks.flags.writeable = False  # as it is where another process writes them: the same compiled code
        _add(bricks, reading.slots, *reading.place, density)


def gather(arena: _Ints, slots: _Ints, place: Place, box: _Ints) -> None:
    """Copy deltas of bricks into those of a box: (y, z, x) int32, C order, out where there is a brick."""
    _copy(arena.reshape(-1), slots, *place, box, False)


def scatter(arena: _Ints, slots: _Ints, place: Place, box: _Ints) -> None:
    """Copy deltas of a box, (y, z, x) int32, C order, into those bricks that are there."""
    _copy(arena.reshape(-1), slots, *place, box, True)


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
                        more = np.float64(arena[at + i]) * VOXELS_PER_UNIT
                        points[to + i] = np.float32(np.float64(points[to + i]) + more)
                    at, to = at + np.uint64(BRICK), to + np.uint64(width)


@kernel
def _copy(arena: _Ints, slots: _Ints, px: int, py: int, pz: int, box: _Ints, into_bricks: bool) -> None:
    """Copy deltas of bricks into those of a box, or the other way."""
    planes, rows, width = box.shape
    points = box.reshape(-1)
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
                    if into_bricks:
                        for i in range(np.uint64(x1 - x0)):
                            arena[at + i] = points[to + i]
                    else:
                        for i in range(np.uint64(x1 - x0)):
                            points[to + i] = arena[at + i]
                    at, to = at + np.uint64(BRICK), to + np.uint64(width)
