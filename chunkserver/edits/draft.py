"""The next bricks of a world, from strokes: what changes is copied first, and settled when all is done.

edits -> fold -> bricks of LOD 0 -> filter up -> bricks of LOD 1 -> ... -> settle -> fresh
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS, Arena, Brick, Held, summarise
from chunkserver.edits.boxes import Box
from chunkserver.edits.brushes import Brushes
from chunkserver.edits.cubes import Cubes, met
from chunkserver.edits.drawing import drawn, margin
from chunkserver.edits.edit import Edit
from chunkserver.edits.fold import fold
from chunkserver.edits.keys import Key
from chunkserver.edits.page import Page
from chunkserver.edits.pyramid import bricks_met, filter_up, read_by
from chunkserver.edits.runs import Field, runs
from chunkserver.edits.strokes import Delta, Stroke

BOXES_AT_ONCE: Final = 1 << 12
"""Of strokes, on all levels that are worked out together: how many places are found at once."""
LEVELS_AT_ONCE: Final = 4
"""That are worked out together: most edits fade on one of the first."""

READ_BRICKS_MAX: Final = 27
"""Of the level below, that a coarser brick is made of."""
ROOM_FACTOR: Final = 2
"""Bricks that change are there twice while they are folded."""

_AROUND: Final = np.array([[-1], [1]])
_Ints = NDArray[np.int64]


class Draft:
    """The next bricks of a world while they are being made. What is there before stays as it is."""

    def __init__(self, before: Callable[[Sequence[Key]], list[Brick | None]], arena: Arena, field: Field) -> None:
        """before: returns the bricks of keys, None for zeros."""
        self._before, self._arena, self._field = before, arena, field
        self._own: dict[Key, Held] = {}
        self._boxes: list[_Ints] = []

    def fold(self, edits: Sequence[Edit]) -> None:
        """Apply edits to LOD 0."""
        for run in runs(edits, self._field):
            of = run.of
            cubes = met(np.zeros(len(of.ops), np.int64), of.boxes, BRICK_BITS)
            if of.alone()[0]:
                self._apply(run.strokes[0], of, cubes)
            else:
                with self._page(cubes, len(cubes.keys)) as page:
                    fold(self._arena, run, cubes, page)
            self._boxes.append(of.boxes)

    def filter_up(self, lods: int) -> None:
        """Work out what has changed on each coarser level, until nothing has."""
        boxes = np.concatenate(self._boxes) if self._boxes else np.empty((0, 2, 3), np.int64)
        at_once, last = min(max(1, BOXES_AT_ONCE // max(1, len(boxes))), LEVELS_AT_ONCE), 0
        while last + 1 < lods and any(key[0] == last for key in reversed(self._own)):
            first, last = last + 1, min(last + at_once, lods - 1)
            coarse = bricks_met(boxes, np.arange(first, last + 1))
            parts, levels = coarse.parts(BRICK_BITS), coarse.keys[:, 0]
            for some in self._pieces(len(parts)):
                cubes = read_by(levels[some], parts[some])
                with self._page(cubes, len(parts[some])) as page:
                    filter_up(self._arena, parts[some], cubes, page)

    def settled(self) -> dict[Key, Brick | None]:
        """Return all bricks that have changed, None where all has become 0."""
        before, own = self._before(list(self._own)), [*self._own.values()]
        bricks = summarise(self._arena, before, own)
        return {key: brick for key, old, brick in zip(self._own, before, bricks, strict=True) if brick is not old}

    def _apply(self, stroke: Stroke, of: Brushes, cubes: Cubes) -> None:
        """Apply one stroke for which there is no kernel. cubes: the bricks that its box meets."""
        low, high = of.boxes[0] + margin(of) * _AROUND
        around = np.stack([low, high])
        wide = met(cubes.keys[:1, 0], around[None], BRICK_BITS)
        box = Box((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        deltas = np.empty(box.shape, np.int32)
        with self._page(wide, 0) as page:
            page.read(self._arena, wide.grids, around, deltas.reshape(-1))
        if isinstance(stroke, Delta):
            new = deltas + stroke.deltas()[box.part_of(stroke.box)]
        else:
            new = drawn(of, self._field(box), deltas)
        with self._page(cubes, len(cubes.keys)) as page:
            page.write(self._arena, cubes.grids, of.boxes[0], new.reshape(-1))

    def _pieces(self, bricks: int) -> Iterator[slice]:
        """Yield coarser bricks so many at a time that there is room for those which they read, whatever is there."""
        at_once = max(1, len(self._arena.deltas) // (ROOM_FACTOR * READ_BRICKS_MAX))
        for first in range(0, bricks, at_once):
            yield slice(first, min(first + at_once, bricks))

    @contextmanager
    def _page(self, cubes: Cubes, changes: int) -> Iterator[Page]:
        """Hold bricks to be read, of which at most so many change. Raises `StoreFull` if there is no room."""
        own, keys = self._own, cubes.places()
        owned = [own.get(key) for key in keys]
        held = [
            mine or (brick.hold() if brick else None) for mine, brick in zip(owned, self._before(keys), strict=True)
        ]
        spare = self._arena.take(min(changes, owned.count(None)))
        page = Page.of(held, [mine is not None for mine in owned], spare)
        yield page
        if page.used[0]:
            fresh = {each.slot: each for each in spare[: int(page.used[0])]}
            for key, slot, mine in zip(keys, page.slots.tolist(), owned, strict=True):
                if mine is None and slot in fresh:
                    own[key] = fresh[slot]
