"""The deltas of one world at one revision, on all levels: a fold of its edits, which can be worked out again from them.

    edits -> fold -> bricks of LOD 0 -> halve -> bricks of LOD 1 -> ...

A `Bricks` never changes, so it may be read while the next one is being made. `apply` copies the bricks that it writes
and shares all others, and works the coarser levels out once for all edits that it takes, only where something changed.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_BITS, Arena, Brick, summarise
from chunkserver.edits.boxes import Box, Place
from chunkserver.edits.brushes import brush
from chunkserver.edits.edit import Edit
from chunkserver.edits.fold import Field, fold, margin
from chunkserver.edits.pyramid import halve
from chunkserver.edits.reading import NONE, Reading, gather, scatter
from chunkserver.edits.strokes import Stroke
from chunkserver.grid import LOD_MAX

CLUSTER_POINTS_MAX: Final = 1 << 18
"""Of a coarser level, worked out at once."""

Key = tuple[int, int, int, int]
"""Of a brick: its level, and x, y, z in bricks of that level."""
_Ints = NDArray[np.int32]


def keys_in(lod: int, box: Box) -> list[Key]:
    """Return the keys of all bricks that meet a box of a level, those that are not there too."""
    xs, ys, zs = (range(low, high + 1) for low, high in zip(*box.cubes(BRICK_BITS), strict=True))
    return [(lod, x, y, z) for y in ys for z in zs for x in xs]


def slots_of(bricks: list[Brick | None], box: Box) -> tuple[_Ints, Place]:
    """Return the grid of slots of the bricks that meet a box, given in the order of `keys_in`, and its place there."""
    x, y, z = box.low
    slots = np.array([NONE if brick is None else brick.slot for brick in bricks], np.int32)
    return slots.reshape(box.cubes(BRICK_BITS).shape), (-(x % BRICK), -(y % BRICK), -(z % BRICK))


class Bricks:
    """All bricks of a world at one revision. Where there is none, deltas are 0.

    lods: how many levels there are. arena: where they lie; a new one if none is given. revision: of the last edit.
    """

    def __init__(self, lods: int = LOD_MAX + 1, arena: Arena | None = None, revision: int = 0) -> None:
        self.lods = lods
        self.arena = Arena() if arena is None else arena
        self.revision = revision
        self._at: dict[Key, Brick] = {}

    @classmethod
    def restored(
        cls, kept: Iterable[tuple[Key, int, _Ints]], revision: int, lods: int, arena: Arena | None = None
    ) -> "Bricks":
        """Return the bricks of a revision as they were kept: of each its key, its revision and its deltas, all levels.

        Raises `StoreFull` if the arena has no room.
        """
        bricks = cls(lods, arena, revision)
        for key, changed, deltas in kept:
            brick = bricks._at[key] = Brick(bricks.arena)
            brick.revision = changed
            brick.deltas[:] = deltas.reshape(BRICK, BRICK, BRICK)
        there = list(bricks._at.values())
        summarise(bricks.arena, [None] * len(there), there)
        return bricks

    def __iter__(self) -> Iterator[tuple[Key, Brick]]:
        """Yield all bricks with their keys."""
        yield from self._at.items()

    def get(self, key: Key) -> Brick | None:
        """Return a brick; None where all deltas are 0."""
        return self._at.get(key)

    def read(self, lod: int, low: Place, shape: tuple[int, int, int]) -> Reading:
        """Return what is to be added to the densities of a box of lattice points.

        low: x, y, z of the first, in steps of the level. shape: how many, (y, z, x).

        The bricks stay where they are for as long as this `Bricks` is kept: keep it until they have been read.
        """
        (planes, rows, width), (x, y, z) = shape, low
        box = Box(low, (x + width - 1, y + planes - 1, z + rows - 1))
        at = self._at
        bricks = [at.get(key) for key in keys_in(lod, box)]
        there = [brick for brick in bricks if brick]
        lowest, highest = min([0, *[brick.low for brick in there]]), max([0, *[brick.high for brick in there]])
        return Reading(*slots_of(bricks, box), lowest, highest)

    def apply(self, edits: Sequence[Edit], revision: int, field: Field) -> "Bricks":
        """Return the bricks after some more edits, in their order; those before do not change.

        revision: of the last of them; it is that of every brick which they change.

        Raises `StoreFull` if the arena has no room, and whatever `field` raises: then nothing has happened.
        """
        draft = _Draft(self, field)
        for edit in edits:
            for stroke in edit.strokes:
                draft.fold(stroke)
        draft.filter_up()
        return draft.publish(revision)


class _Draft:
    """The next `Bricks` while it is being made.

    _fresh: bricks of its own, None where all has become 0. _written: boxes of the level that is being written, and the
    bricks that meet each.
    """

    def __init__(self, before: Bricks, field: Field) -> None:
        self._before, self._arena, self._field = before, before.arena, field
        self._fresh: dict[Key, Brick | None] = {}
        self._written: dict[Box, list[Key]] = {}

    def fold(self, stroke: Stroke) -> None:
        """Apply a stroke to LOD 0."""
        of = brush(stroke)
        if of.box.points:
            around = of.box.grown(margin(stroke))
            deltas = self._gather(0, around)
            fold(stroke, of, self._field, deltas)
            self._scatter(0, of.box, np.ascontiguousarray(deltas[of.box.part_of(around)]))

    def _gather(self, lod: int, box: Box) -> _Ints:
        """Return the deltas of a box of a level: (y, z, x) int32."""
        deltas = np.zeros(box.shape, np.int32)
        fresh, get = self._fresh, self._before.get
        bricks = [fresh[key] if key in fresh else get(key) for key in keys_in(lod, box)]
        if any(bricks):
            gather(self._arena.deltas, *slots_of(bricks, box), deltas)
        return deltas

    def _scatter(self, lod: int, box: Box, deltas: _Ints) -> None:
        """Write the deltas of a box of a level into bricks of this draft's own."""
        keys, fresh = keys_in(lod, box), self._fresh
        for key in keys:
            if fresh.get(key) is None:
                fresh[key] = Brick(self._arena, None if key in fresh else self._before.get(key))
        self._written[box] = keys
        scatter(self._arena.deltas, *slots_of([fresh[key] for key in keys], box), deltas)

    def filter_up(self) -> None:
        """Settle LOD 0, then work out what has changed on each coarser level, until nothing has."""
        changed = self._settle()
        for lod in range(1, self._before.lods):
            for box in _clusters(box.coarser() for box in changed):
                self._scatter(lod, box, halve(self._gather(lod - 1, box.finer())))
            changed = self._settle()
            if not changed:
                return

    def _settle(self) -> list[Box]:
        """Drop fresh bricks that are as they were, or all 0. Return the boxes with a change in one of their bricks."""
        written, self._written = self._written, {}
        keys = list(dict.fromkeys(key for of_box in written.values() for key in of_box))
        old, fresh = [self._before.get(key) for key in keys], [brick for key in keys if (brick := self._fresh[key])]
        unchanged = set()
        for key, brick, differs in zip(keys, fresh, summarise(self._arena, old, fresh), strict=True):
            if not differs:
                unchanged.add(key)
                del self._fresh[key]
            elif brick.low == brick.high == 0:
                self._fresh[key] = None
        return [box for box, of_box in written.items() if not unchanged.issuperset(of_box)]

    def publish(self, revision: int) -> Bricks:
        """Return the bricks as they are now."""
        after = Bricks(self._before.lods, self._arena, revision)
        after._at = dict(self._before._at)
        for key, brick in self._fresh.items():
            if brick is None:
                del after._at[key]
            else:
                brick.revision = revision
                after._at[key] = brick
        return after


def _clusters(boxes: Iterable[Box]) -> list[Box]:
    """Return boxes around all of these: neighbours in the list are put together where that adds few points."""
    clusters: list[Box] = []
    for box in boxes:
        joined = box.joined(clusters[-1]) if clusters else box
        if clusters and joined.points <= min(2 * (clusters[-1].points + box.points), CLUSTER_POINTS_MAX):
            clusters[-1] = joined
        else:
            clusters.append(box)
    return clusters
