"""Where deltas are kept: cubes of them, in slots of one array while they are read, packed while they are not.

    Brick --- held ---> slot of the arena: a row of one array       any process that maps it can read the deltas
          --- packed -> a few hundred bytes                         all that is left, when others want the slot

A brick is BRICK^3 deltas at the lattice points of its level, in the order of samples: y, z, x. Whoever knows the array,
a few slots and where these lie needs nothing else to read them.
"""

import threading
import weakref
from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.packing import packed, unpack
from chunkserver.errors import StoreFull
from chunkserver.kernel import choose, kernel

BRICK_BITS: Final = 4
BRICK: Final = 1 << BRICK_BITS
"""Deltas a side."""
BRICK_DELTAS: Final = BRICK**3
NONE: Final = -1
"""Stands for the slot of a brick that is not there."""
SLOTS_DEFAULT: Final = 1 << 15
"""512 MiB, of which the system gives what is written."""
WEIGHT_MAX_DEFAULT: Final = 1 << 30
BRICK_WEIGHT: Final = 512
"""Bytes that a brick takes beside its deltas, about: itself, its key and its place among others."""

_Ints = NDArray[np.int32]


class Held:
    """A slot that something lies in, for as long as anything refers to this."""

    __slots__ = ("_free", "slot")

    def __init__(self, slot: int, free: deque[int]) -> None:
        self.slot, self._free = slot, free

    def __del__(self) -> None:
        """Give the slot back."""
        self._free.append(self.slot)


class Holds(list[Held | None]):
    """Some of them. In another process there are none: a slot is given back where it was taken."""

    def __reduce__(self) -> tuple[type[tuple[()]], tuple[()]]:
        """Send nothing."""
        return tuple, ()


class Arena:
    """Slots for bricks, in memory of any shape that has whole bricks. Safe in any thread.

    deltas: (slots, BRICK_DELTAS) int32, C order: where they lie. Its memory may be shared with other processes.
    weight: bytes that are known of beside that array: of packed bricks, and what others have added to it.
    reserved, promised: bricks that edits may want, and bytes that they may add, which are not folded yet.
    weight_max: what `weight` should not pass with what is promised. Nothing here looks at these three.
    lock: of what is in which slot.
    """

    def __init__(self, deltas: _Ints | None = None, weight_max: int = WEIGHT_MAX_DEFAULT) -> None:
        memory = np.zeros(SLOTS_DEFAULT * BRICK_DELTAS, np.int32) if deltas is None else deltas
        self.deltas = memory.reshape(-1, BRICK_DELTAS)
        self.weight, self.weight_max = 0, weight_max
        self.reserved = self.promised = 0
        self.lock = threading.RLock()
        self._free: deque[int] = deque()
        self._used = 0
        self._settled: list[weakref.ref[Brick] | None] = []
        self._hand = 0

    @property
    def taken(self) -> int:
        """How many slots have bricks in them."""
        return self._used - len(self._free)

    def take(self, count: int) -> list[Held]:
        """Return so many slots that nothing lies in; what was there before has to be overwritten.

        Bricks that nobody has held for long are packed if need be. Raises `StoreFull` if too many slots are in use.
        """
        free, taken = self._free, []
        with self.lock:
            for _ in range(count):
                if not free and self._used < len(self.deltas):
                    self._used += 1
                    self._settled.append(None)
                    taken.append(Held(self._used - 1, free))
                else:
                    self._make_room()
                    taken.append(Held(free.popleft(), free))
        return taken

    def settle(self, brick: "Brick", slot: int) -> None:
        """Let a brick that is not written to any more be packed, when its slot is wanted."""
        self._settled[slot] = weakref.ref(brick)

    def weigh(self, more: int) -> None:
        """Add to the weight, or take away from it."""
        with self.lock:
            self.weight += more

    def reserve(self, bricks: int, weight: int) -> None:
        """Add to what edits may want that are not folded yet, or take away from it."""
        with self.lock:
            self.reserved += bricks
            self.promised += weight

    def _make_room(self) -> None:
        """Pack bricks until a slot is free: in turn, but for those that were held since the last turn."""
        looks = 2 * self._used
        while not self._free:
            if not looks:
                raise StoreFull(f"all {self._used} bricks that memory has room for are in use", bricks=self._used)
            looks -= 1
            self._hand = (self._hand + 1) % self._used
            settled = self._settled[self._hand]
            brick = settled and settled()
            if brick and brick.let_go():
                self._settled[self._hand] = None


class Brick:
    """One brick, which never changes.

    low, high: its lowest and highest delta, units.
    """

    __slots__ = ("__weakref__", "_arena", "_held", "_packed", "_wanted", "_weight", "high", "low")

    def __init__(self, arena: Arena, held: Held | None, low: int = 0, high: int = 0) -> None:
        """Lie in a slot, or in none yet: then it has to be packed at once."""
        self._arena, self._held, self.low, self.high = arena, held, low, high
        self._packed: bytes | None = None
        self._wanted = True
        self._weight = 0

    @classmethod
    def kept(cls, arena: Arena, low: int, high: int, content: bytes) -> "Brick":
        """Return a brick that was packed: it takes a slot when it is held."""
        brick = cls(arena, None, low, high)
        brick._pack(content)
        return brick

    def __del__(self) -> None:
        """Take its weight away."""
        if self._weight:
            self._arena.weigh(-self._weight)

    @property
    def deltas(self) -> _Ints:
        """A copy of the brick's deltas: (y, z, x) int32."""
        held = self.hold()
        deltas: _Ints = self._arena.deltas[held.slot].reshape(BRICK, BRICK, BRICK).copy()
        return deltas

    @property
    def packed(self) -> bytes:
        """The brick's deltas in few bytes, for `kept`."""
        held = self._held
        if self._packed is None and held is not None:  # it never has neither
            content = packed(self._arena.deltas[held.slot])  # without the lock: it takes 60 us, and others want slots
            with self._arena.lock:
                if self._packed is None:
                    self._pack(content)
        assert self._packed is not None
        return self._packed

    def hold(self) -> Held:
        """Return its slot, in which its deltas are for as long as that is referred to. Raises `StoreFull`."""
        self._wanted = True
        held = self._held
        return self._unpack() if held is None else held

    def let_go(self) -> bool:
        """Give the slot up, unless it was held since this was asked last. Return whether it has none any more."""
        if self._wanted:
            self._wanted = False
            return False
        self.packed  # noqa: B018 - it is, from now on
        self._held = None
        return True

    def _pack(self, content: bytes) -> None:
        self._weight = BRICK_WEIGHT + len(content)
        self._arena.weigh(self._weight)
        self._packed = content

    def _unpack(self) -> Held:
        with self._arena.lock:
            held = self._held
            if held is None:
                [held] = self._arena.take(1)
                assert self._packed is not None
                unpack(self._packed, self._arena.deltas[held.slot])
                self._held = held
                self._arena.settle(self, held.slot)
            return held


def summarise(arena: Arena, before: Sequence[Brick | None], after: Sequence[Held]) -> list[Brick | None]:
    """Return what has come of bricks: None for zeros, the one of `before` where no delta is another one.

    after: where each lies now. It is not written to any more.
    """
    if not after:
        return []
    found = np.empty((len(after), 3), np.int32)
    held = [None if brick is None else brick.hold() for brick in before]
    old, new = (np.array([NONE if each is None else each.slot for each in one], np.int32) for one in (held, after))
    _compare(arena.deltas.reshape(-1), old, new, found)
    bricks: list[Brick | None] = []
    for old_brick, slot, (low, high, differs) in zip(before, after, found.tolist(), strict=True):
        if not differs:
            bricks.append(old_brick)
        elif low == high == 0:
            bricks.append(None)
        else:
            bricks.append(brick := Brick(arena, slot, low, high))
            arena.settle(brick, slot.slot)
    return bricks


@kernel
def _compare(arena: _Ints, before: _Ints, after: _Ints, found: _Ints) -> None:
    """found: (bricks, 3) out: lowest and highest delta of `after`, and bits that differ: NONE is zeros."""
    for n in range(after.size):
        new = np.uint64(after[n]) * np.uint64(BRICK_DELTAS)
        low = high = arena[new]
        differs = np.int32(0)
        for i in range(np.uint64(BRICK_DELTAS)):
            delta = arena[new + i]
            low, high = choose(delta < low, delta, low), choose(delta > high, delta, high)
        if before[n] == NONE:
            differs = low | high
        else:
            old = np.uint64(before[n]) * np.uint64(BRICK_DELTAS)
            for i in range(np.uint64(BRICK_DELTAS)):
                differs |= arena[new + i] ^ arena[old + i]
        found[n, 0], found[n, 1], found[n, 2] = low, high, differs
