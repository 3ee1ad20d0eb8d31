"""The next bricks of a world, from strokes: those that are written to are copied first, and settled level by level.

edits -> fold -> bricks of LOD 0 -> filter up -> bricks of LOD 1 -> ...
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS, NONE, Arena, Brick, Holds, summarise
from chunkserver.edits.boxes import Box
from chunkserver.edits.brushes import Brushes
from chunkserver.edits.cubes import ALL, Cubes, met
from chunkserver.edits.drawing import drawn, margin
from chunkserver.edits.edit import Edit
from chunkserver.edits.fold import Grids, fold
from chunkserver.edits.keys import Key
from chunkserver.edits.pyramid import bricks_met, filter_up, finer
from chunkserver.edits.reading import GATHER, SCATTER, copy
from chunkserver.edits.runs import Field, runs
from chunkserver.edits.strokes import Delta, Stroke

BOXES_AT_ONCE: Final = 1 << 12
"""Of strokes, on all levels that are worked out after each other: how many places are found at once."""

READ_BRICKS_MAX: Final = 27
"""Of the level below, that a coarser brick is made of."""
ROOM_FACTOR: Final = 2
"""Bricks that change are there twice while they are folded."""

_AROUND: Final = np.array([[-1], [1]])
_Ints = NDArray[np.int64]


class Draft:
    """The next bricks of a world while they are being made.

    fresh: bricks of its own, None where all has become 0.
    """

    def __init__(self, before: Callable[[Key], Brick | None], arena: Arena, field: Field) -> None:
        """before: returns the brick of a key, None for zeros; what is there before stays as it is."""
        self.fresh: dict[Key, Brick | None] = {}
        self._before, self._arena, self._field = before, arena, field
        self._boxes: list[_Ints] = []

    def fold(self, edits: Sequence[Edit]) -> None:
        """Apply edits to LOD 0."""
        for run in runs(edits, self._field):
            of = run.of
            cubes = met(np.zeros(len(of.ops), np.int64), of.boxes, BRICK_BITS)
            if of.alone()[0]:
                self._apply(run.strokes[0], of, cubes)
            else:
                fold(self._arena.deltas, run, _grids(cubes, self._own(cubes.places()), ALL))
            self._boxes.append(of.boxes)

    def _apply(self, stroke: Stroke, of: Brushes, cubes: Cubes) -> None:
        """Apply one stroke for which there is no kernel. cubes: the bricks that its box meets."""
        low, high = of.boxes[0] + margin(of) * _AROUND
        around = np.stack([low, high])
        wide = met(cubes.keys[:1, 0], around[None], BRICK_BITS)
        box = Box((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        deltas = np.empty(box.shape, np.int32)
        plain = self._arena.deltas.reshape(-1)
        grid = _grids(wide, self._now(wide.places()), ALL)
        copy(plain, grid.slots, around, deltas.reshape(-1), GATHER)
        new = deltas + stroke.deltas() if isinstance(stroke, Delta) else drawn(of, self._field(box), deltas)
        grid = _grids(cubes, self._own(cubes.places()), ALL)
        copy(plain, grid.slots, of.boxes[0], new.reshape(-1), SCATTER)

    def filter_up(self, lods: int) -> None:
        """Settle LOD 0, then work out what has changed on each coarser level, until nothing has."""
        more = self._settle(list(self.fresh))
        boxes = np.concatenate(self._boxes) if self._boxes else np.empty((0, 2, 3), np.int64)
        at_once = max(1, BOXES_AT_ONCE // max(1, len(boxes)))
        for first in range(1, lods, at_once):
            more = more and self._filter(boxes, np.arange(first, min(first + at_once, lods)))

    def _filter(self, boxes: _Ints, lods: _Ints) -> bool:
        """Work some levels out, one after the other. Return whether something has changed on the last."""
        cubes = bricks_met(boxes, lods)
        parts = cubes.parts(BRICK_BITS)
        fine = finer(parts)
        read = met(cubes.keys[:, 0] - 1, fine, BRICK_BITS)
        for here, below in zip(_levels(cubes), _levels(read), strict=True):
            known, keys = self._now(read.places(below)), cubes.places(here)
            own = np.array([brick.hold().slot for brick in self._own(keys)], np.int32)
            for some in self._pieces(here):
                grids = _grids(read, known, some, below.start)
                slots = own[some.start - here.start : some.stop - here.start]
                filter_up(self._arena.deltas, grids, fine[some], slots, parts[some])
            if not self._settle(keys):
                return False
        return True

    def _pieces(self, bricks: slice) -> Iterator[slice]:
        """Yield coarser bricks so many at a time that there is room for those which they read, whatever is there."""
        at_once = max(1, len(self._arena.deltas) // (ROOM_FACTOR * READ_BRICKS_MAX))
        for first in range(bricks.start, bricks.stop, at_once):
            yield slice(first, min(first + at_once, bricks.stop))

    def _own(self, keys: Iterable[Key]) -> list[Brick]:
        """Return bricks that may be written to: this draft's own."""
        fresh, own = self.fresh, []
        for key in keys:
            brick = fresh.get(key)
            if brick is None:
                brick = fresh[key] = Brick.fresh(self._arena, self._before(key))
            own.append(brick)
        return own

    def _now(self, keys: Iterable[Key]) -> list[Brick | None]:
        """Return bricks as they are now."""
        fresh, before = self.fresh, self._before
        return [fresh[key] if key in fresh else before(key) for key in keys]

    def _settle(self, keys: Sequence[Key]) -> bool:
        """Drop fresh bricks that are as they were, or all 0. Return whether any has a change."""
        old, fresh = [self._before(key) for key in keys], [brick for key in keys if (brick := self.fresh[key])]
        found = summarise(self._arena, old, fresh)
        for key, brick, differs in zip(keys, fresh, found, strict=True):
            if not differs:
                del self.fresh[key]
            elif brick.low == brick.high == 0:
                self.fresh[key] = None
        return any(found)


def _grids(cubes: Cubes, bricks: Sequence[Brick | None], boxes: slice, first: int = 0) -> Grids:
    """Return the grids of some boxes. bricks: those that lie in the cubes from number `first` on.

    No more are held than these boxes meet. Raises `StoreFull` if there is no room for them.
    """
    starts, stop = cubes.starts[boxes], boxes.stop
    end = cubes.starts[stop] if stop is not None and stop < len(cubes.starts) else len(cubes.grids)
    numbers = cubes.grids[starts[0] : end] - first
    if len(bricks) > len(numbers):
        used, at = np.unique(numbers, return_inverse=True)
        bricks, numbers = [bricks[number] for number in used.tolist()], at.astype(np.int32)
    held = Holds(None if brick is None else brick.hold() for brick in bricks)
    slots = np.array([NONE if each is None else each.slot for each in held], np.int32)
    return Grids(slots[numbers], starts - starts[0], held)


def _levels(cubes: Cubes) -> list[slice]:
    """Return where the cubes of each level are, which are their groups, in their order."""
    turns = np.flatnonzero(np.diff(cubes.keys[:, 0])) + 1
    return [slice(first, last) for first, last in pairwise([0, *turns.tolist(), len(cubes.keys)])]
