"""Bricks that are worked on: read wherever they lie, and copied when the first of their deltas changes.

cubes    0  1  2  3          numbers in the grids of boxes
slots    7  9  -  4          where each lies now
owned    .  x  .  .          cube 1 was copied from a slot of others to slot 9, which was a spare one
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_BITS, BRICK_DELTAS, NONE, Arena, Held
from chunkserver.kernel import inlined, kernel

_Ints = NDArray[np.int32]
_Places = NDArray[np.int64]
_Flags = NDArray[np.bool_]


class Page(NamedTuple):
    """The bricks of some cubes, for kernels.

    slots: (cubes,) int32, in and out: where each lies, or NONE where all is 0. owned: (cubes,) bool, in and out:
        whether it may be written to where it lies. spare: (n,) int32, the slots that may be taken, one for each cube
        that is written to and not owned. used: (1,) int64, in and out: how many of them are.
    """

    slots: _Ints
    owned: _Flags
    spare: _Ints
    used: _Places

    @classmethod
    def of(cls, held: Sequence[Held | None], owned: Sequence[bool], spare: Sequence[Held]) -> "Page":
        """Return the page of cubes that lie in these slots, which have to be kept meanwhile."""
        slots = np.array([NONE if each is None else each.slot for each in held], np.int32)
        free = np.array([each.slot for each in spare], np.int32)
        return cls(slots, np.array(owned, np.bool_), free, np.zeros(1, np.int64))

    def read(self, arena: Arena, grid: _Ints, box: _Places, points: _Ints) -> None:
        """Copy deltas to those of a box. grid: the numbers of the cubes that it meets, (y, z, x).

        box: (2, 3) int64, first and last point x, y, z. points: (y * z * x,) int32, out.
        """
        gather(arena.deltas.reshape(-1), self.slots, grid, box, points)

    def write(self, arena: Arena, grid: _Ints, box: _Places, points: _Ints) -> None:
        """Copy the other way: what has another delta is owned from now on."""
        put(arena.deltas.reshape(-1), *self, grid, box, points)


@kernel
def gather(arena: _Ints, slots: _Ints, grid: _Ints, box: _Places, points: _Ints) -> None:
    """Copy deltas of bricks to those of a box, with 0 where there is no brick, as `Page.read` does."""
    x0, y0, z0, x1, y1, z1 = box[0, 0], box[0, 1], box[0, 2], box[1, 0], box[1, 1], box[1, 2]
    first, last = x0 >> BRICK_BITS, x1 >> BRICK_BITS
    along, across = last - first + 1, (z1 >> BRICK_BITS) - (z0 >> BRICK_BITS) + 1
    to = np.uint64(0)
    for y in range(y0, y1 + 1):
        for z in range(z0, z1 + 1):
            brick = (((y >> BRICK_BITS) - (y0 >> BRICK_BITS)) * across + (z >> BRICK_BITS) - (z0 >> BRICK_BITS)) * along
            row = ((y & BRICK - 1) * BRICK + (z & BRICK - 1)) * BRICK
            for d in range(along):
                start = max(x0, (first + d) * BRICK)
                count = np.uint64(min(x1, (first + d) * BRICK + BRICK - 1) - start + 1)
                slot = np.int64(slots[grid[brick + d]])
                if slot == NONE:
                    for i in range(count):
                        points[to + i] = 0
                else:
                    at = np.uint64(slot * BRICK_DELTAS + row + (start & BRICK - 1))
                    for i in range(count):
                        points[to + i] = arena[at + i]
                to += count


@kernel
def put(
    arena: _Ints,
    slots: _Ints,
    owned: _Flags,
    spare: _Ints,
    used: _Places,
    grid: _Ints,
    box: _Places,
    points: _Ints,
) -> None:
    """Copy deltas of a box to those of bricks, as `Page.write` does."""
    x, y, z = box[0, 0] >> BRICK_BITS, box[0, 1] >> BRICK_BITS, box[0, 2] >> BRICK_BITS
    along, across = (box[1, 0] >> BRICK_BITS) - x + 1, (box[1, 2] >> BRICK_BITS) - z + 1
    for at in range(along * across * ((box[1, 1] >> BRICK_BITS) - y + 1)):
        n = grid[at]
        a, b, c = (x + at % along) * BRICK, (y + at // (along * across)) * BRICK, (z + at // along % across) * BRICK
        if not owned[n]:
            if not _rows(arena, np.int64(slots[n]), a, b, c, box, points, False):
                continue
            new, old = np.uint64(spare[used[0]]) * np.uint64(BRICK_DELTAS), np.int64(slots[n])
            if old == NONE:
                for i in range(np.uint64(BRICK_DELTAS)):
                    arena[new + i] = 0
            else:
                start = np.uint64(old) * np.uint64(BRICK_DELTAS)
                for i in range(np.uint64(BRICK_DELTAS)):
                    arena[new + i] = arena[start + i]
            slots[n], owned[n] = spare[used[0]], True
            used[0] += 1
        _rows(arena, np.int64(slots[n]), a, b, c, box, points, True)


@inlined
def _rows(arena: _Ints, slot: np.int64, a: int, b: int, c: int, box: _Places, points: _Ints, writes: bool) -> bool:
    """Write what a box has of the brick that begins at a, b, c; or return whether that differs from the brick."""
    x0, y0, z0 = max(a, box[0, 0]), max(b, box[0, 1]), max(c, box[0, 2])
    x1, y1, z1 = min(a + BRICK - 1, box[1, 0]), min(b + BRICK - 1, box[1, 1]), min(c + BRICK - 1, box[1, 2])
    width, rows = box[1, 0] - box[0, 0] + 1, box[1, 2] - box[0, 2] + 1
    count, differs = np.uint64(x1 - x0 + 1), np.int32(0)
    for y in range(y0, y1 + 1):
        for z in range(z0, z1 + 1):
            start = np.uint64(((y - box[0, 1]) * rows + z - box[0, 2]) * width + x0 - box[0, 0])
            at = np.uint64(max(slot, np.int64(0)) * BRICK_DELTAS + ((y - b) * BRICK + z - c) * BRICK + x0 - a)
            if writes:
                for i in range(count):
                    arena[at + i] = points[start + i]
            elif slot == NONE:
                for i in range(count):
                    differs |= points[start + i]
            else:
                for i in range(count):
                    differs |= points[start + i] ^ arena[at + i]
    return bool(differs)
