"""Where deltas are kept: cubes of them, in slots of one array, written once and then only read.

A brick is BRICK^3 deltas at the lattice points of its level, in the order of samples: y, z, x. Its slot is a row of an
arena, so whoever knows the array, a few slots and where these lie needs nothing else to read them: also another process
that maps the same memory.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import StoreFull
from chunkserver.kernel import choose, kernel

BRICK_BITS: Final = 4
BRICK: Final = 1 << BRICK_BITS
"""Deltas a side."""
BRICK_DELTAS: Final = BRICK**3
SLOTS_DEFAULT: Final = 1 << 15
"""512 MiB, of which the system gives what is written."""

_Ints = NDArray[np.int32]


class Arena:
    """Slots for bricks, in memory of any shape that has whole bricks.

    deltas: (slots, BRICK_DELTAS) int32, C order: where they lie. Its memory may be shared with other processes.
    reserved: slots that edits may want which are not folded yet. `take` does not look at it.
    """

    def __init__(self, deltas: _Ints | None = None) -> None:
        memory = np.zeros(SLOTS_DEFAULT * BRICK_DELTAS, np.int32) if deltas is None else deltas
        self.deltas = memory.reshape(-1, BRICK_DELTAS)
        self._given_back: list[int] = []
        self._used = 0
        self.reserved = 0

    @property
    def taken(self) -> int:
        """How many slots have bricks in them."""
        return self._used - len(self._given_back)

    def take(self) -> int:
        """Return a slot that nothing lies in; what was there before has to be overwritten. Raises `StoreFull`."""
        if self._given_back:
            return self._given_back.pop()
        if self._used == len(self.deltas):
            raise StoreFull(f"there is no room for more than {self._used} bricks of edits", bricks=self._used)
        self._used += 1
        return self._used - 1

    def give_back(self, slot: int) -> None:
        """Let a slot be taken again."""
        self._given_back.append(slot)


class Brick:
    """One brick. It has its slot for as long as anything refers to it.

    slot: in `arena`. low, high: its lowest and highest delta, units. revision: that of the edits that changed it last.
    """

    __slots__ = ("arena", "high", "low", "revision", "slot")

    def __init__(self, arena: Arena, like: "Brick | None" = None) -> None:
        """Take a slot and copy another brick into it, or zeros."""
        self.slot = -1
        self.arena, self.low, self.high, self.revision = arena, 0, 0, 0
        self.slot = arena.take()
        arena.deltas[self.slot] = 0 if like is None else arena.deltas[like.slot]

    def __del__(self) -> None:
        """Give the slot back."""
        if self.slot >= 0:
            self.arena.give_back(self.slot)

    @property
    def deltas(self) -> _Ints:
        """The brick's deltas: (y, z, x) int32."""
        deltas: _Ints = self.arena.deltas[self.slot].reshape(BRICK, BRICK, BRICK)
        return deltas


def summarise(arena: Arena, before: Sequence[Brick | None], after: Sequence[Brick]) -> list[bool]:
    """Note what each brick of `after` lies between; return whether it differs from that of `before`, None for zeros."""
    if not after:
        return []
    found = np.empty((len(after), 3), np.int32)
    old = np.array([-1 if brick is None else brick.slot for brick in before], np.int32)
    _compare(arena.deltas.reshape(-1), old, np.array([brick.slot for brick in after], np.int32), found)
    rows = found.tolist()
    for brick, (low, high, _) in zip(after, rows, strict=True):
        brick.low, brick.high = low, high
    return [bool(differs) for _, _, differs in rows]


@kernel
def _compare(arena: _Ints, before: _Ints, after: _Ints, found: _Ints) -> None:
    """found: (bricks, 3) out: lowest and highest delta of `after`, and bits that differ from `before`: -1 is zeros."""
    for n in range(after.size):
        new = np.uint64(after[n]) * np.uint64(BRICK_DELTAS)
        low = high = arena[new]
        differs = np.int32(0)
        for i in range(np.uint64(BRICK_DELTAS)):
            delta = arena[new + i]
            low, high = choose(delta < low, delta, low), choose(delta > high, delta, high)
        if before[n] < 0:
            differs = low | high
        else:
            old = np.uint64(before[n]) * np.uint64(BRICK_DELTAS)
            for i in range(np.uint64(BRICK_DELTAS)):
                differs |= arena[new + i] ^ arena[old + i]
        found[n, 0], found[n, 1], found[n, 2] = low, high, differs
