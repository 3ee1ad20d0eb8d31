"""The edits of one world, from the moment that they are taken to their bricks; and which of them reached a chunk last.

    measured -> taken -> written -> unfolded -> publish -> folded: in the bricks
                      -> dropped

Takes, writes and folds are in the same order. What an edit can change is known when it is taken, from the bricks that
there are then and from the boxes of all edits between. So it is known at any time which edit is a chunk's last, and
which is its last of those that are folded. Pure: whoever writes and folds does so elsewhere, and says when it is done.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import islice
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.bricks import Bricks
from chunkserver.edits.draft import ROOM_FACTOR
from chunkserver.edits.edit import Edit
from chunkserver.edits.effect import Bounds, narrowed
from chunkserver.edits.headroom import Headroom
from chunkserver.edits.keys import Key
from chunkserver.edits.parts import Change, restored
from chunkserver.edits.pyramid import bricks_met
from chunkserver.edits.reach import Range, read_ranges, stale, written
from chunkserver.edits.reached import GROUP_WEIGHT, Group, Reached, groups_met
from chunkserver.edits.waiting import Waiting
from chunkserver.errors import ChunkError, Overloaded, StoreFull
from chunkserver.grid import ChunkKey

WRITTEN_GROUPS_MAX: Final = 1 << 16
"""50 MB, that were reached since no edit waited to be folded: with more, those that wait are noted anew."""
UNFOLDED_MAX: Final = 4096
"""Edits that are not folded yet: beyond that, one more is refused."""


class Taken(NamedTuple):
    """An edit that was taken, and may be written.

    edit: with boxes outside which it changes no delta. boxes: those of its strokes that have a point. stale: the chunks
        that it may change. weight: bytes that noting these may take. bricks: how many are written to for it at most.
    """

    edit: Edit
    boxes: NDArray[np.int64]
    stale: Sequence[Range]
    weight: int
    bricks: int

    @property
    def chunks(self) -> int:
        """How many chunks it may change."""
        return int(math.fsum(math.prod(b - a + 1 for a, b in zip(*ends, strict=True)) for _, *ends in self.stale))

    @property
    def told(self) -> bytes:
        """What it makes stale, as JSON: a list of objects with `lod`, and the `min` and `max` of a range of chunks."""
        return written(self.stale)


class History:
    """The edits of a world, and its bricks.

    bricks: as of the last edit that is folded. revision: of the last edit that is written.
    """

    def __init__(self, bricks: Bricks, bounds: Bounds, cells: int, reached: Reached | None = None) -> None:
        """Begin with bricks, which nobody has edited unless it is said which edits have `reached` which chunks.

        bounds: of the field, `effect.Bounds`. cells: of a chunk's side.
        """
        self.bricks = bricks
        self.revision = bricks.revision
        self._bounds, self._cells = bounds, cells
        self._headroom = Headroom(bricks)
        self._reached = Reached() if reached is None else reached
        self._written = Reached()
        self._unnoted: list[tuple[int, Sequence[Range]]] = []
        self._taken: deque[Taken] = deque()
        self._unfolded: deque[Taken] = deque()
        self._waiting = Waiting(bricks.lods)
        self._reserved = self._promised = 0
        self._changed: set[Key] = set()
        self._kept = None if reached is None else bricks.revision
        bricks.arena.weigh(GROUP_WEIGHT * self._reached.groups)

    @classmethod
    def restored(
        cls, parts: Iterable[tuple[bytes, bytes]], before: Bricks, revision: int, bounds: Bounds, cells: int
    ) -> "History":
        """Return the history of a revision. Its bricks take no slots yet. Raises `StoreError` for what is no part.

        parts: all that make up `revision`, names and contents, as `Change` has them. before: the bricks without edits.
        """
        bricks, reached = restored(parts, revision, before.lods, before.arena)
        return cls(bricks, bounds, cells, reached)

    def __del__(self) -> None:
        """Take its weight away, and give back the room of edits that are not folded any more."""
        self.bricks.arena.weigh(-GROUP_WEIGHT * self._reached.groups)
        self.bricks.arena.reserve(-self._reserved, -self._promised)

    @property
    def waiting(self) -> int:
        """How many edits are taken, and neither dropped nor folded."""
        return len(self._taken) + len(self._unfolded)

    def take(self, edit: Edit) -> Taken:
        """Return the edit with what it may change. It counts until it is dropped or folded.

        Raises `Overloaded` if too many wait to be folded, `StoreFull` if there is no room for what it makes,
        `BadStroke` if a delta could become too large; what is known of unfolded edits is coarse, so that an edit that
        is refused for this may be taken when they are folded. Then nothing has changed.
        """
        return self.took(self.measuring(edit)())

    def measuring(self, edit: Edit) -> Callable[[], Taken]:
        """Return what finds out what an edit may change: give that to `took`, before another edit is measured.

        It may run in another thread. Raises `Overloaded`.
        """
        if self.waiting >= UNFOLDED_MAX:
            raise Overloaded(f"{self.waiting} edits of this world wait to be worked out", waiting=self.waiting)
        return partial(_measured, edit, self.bricks, self._bounds, self._waiting.boxes, self._cells)

    def took(self, taken: Taken) -> Taken:
        """Count an edit that was measured. Raises what `take` does."""
        self._check_room(taken)
        self._headroom.take(taken.edit, self.revision + len(self._taken) + 1)
        self._taken.append(taken)
        self._join(taken)
        return taken

    def logged(self, source: bytes, told: bytes, *, on_other_ground: bool = False) -> None:
        """Note the next edit that the log has, at a start. All of those have to be folded before another one is taken.

        source: of the edit. told: what it makes stale, as it was told then. on_other_ground: another field was edited
        then: all that it could change in any field counts too.
        """
        edit, ranges = Edit.read(source), read_ranges(told)
        boxes = edit.brushes.with_points()
        if on_other_ground:
            ranges += stale(boxes, self._cells, self.bricks.lods)
        taken = _taken(edit, boxes, ranges, self.bricks.lods)
        self._join(taken)
        self._unfolded.append(taken)
        self.revision += 1
        self._unnoted.append((self.revision, ranges))

    def written(self, taken: Taken, revision: int) -> None:
        """Note that the log has an edit that was taken, as `revision`: the next one of this world."""
        assert revision == self.revision + 1, f"revision {revision} follows {self.revision}"
        self._leave(taken)
        self._unfolded.append(taken)
        self.revision = revision
        self._unnoted.append((revision, taken.stale))

    def dropped(self, taken: Taken) -> None:
        """Note that an edit that was taken is not written."""
        self._leave(taken)
        self._waiting.drop(taken.bricks, [each.boxes for each in (*self._unfolded, *self._taken)])
        self._reserve(-taken.weight)
        if not self.waiting:
            self._settle()

    def unfolded(self, count: int) -> list[Edit]:
        """Return the first edits, at most `count`, that are written and not folded."""
        return [taken.edit for taken in islice(self._unfolded, count)]

    def publish(self, bricks: Bricks) -> None:
        """Go on from these bricks, which `apply` has made: the first of the unfolded edits are in them."""
        before, arena = self._reached.groups, self.bricks.arena
        for revision in range(self.bricks.revision + 1, bricks.revision + 1):
            taken = self._unfolded.popleft()
            self._reached.note(revision, taken.stale)
            self._waiting.leave(taken.boxes, taken.bricks)
            self._reserve(-taken.weight)
        arena.weigh(GROUP_WEIGHT * (self._reached.groups - before))
        self.bricks = bricks
        self._changed.update(bricks.changed)
        self._settle()
        if not self._unfolded or self._written.groups > WRITTEN_GROUPS_MAX:
            self._written = Reached()
            self._unnoted = [(bricks.revision + at, taken.stale) for at, taken in enumerate(self._unfolded, 1)]

    def last_edit(self, key: ChunkKey) -> int:
        """Return the revision of the last edit that is written and has reached a chunk; 0 if none has."""
        for revision, ranges in self._unnoted:  # only when somebody asks: most are folded before
            self._written.note(revision, ranges)
        self._unnoted.clear()
        return max(self._written.last(key), self._reached.last(key))

    def last_folded(self, key: ChunkKey) -> int:
        """Return the revision of the last edit that is in the bricks and has reached a chunk; 0 if none has."""
        return self._reached.last(key)

    def change(self, *, everything: bool = False) -> Change:
        """Return what folded edits have changed since this was called last: all if it never was, or if that is asked.

        What it was called for has to be kept, or all is asked for next time.
        """
        keys: Iterable[Key] = self._changed
        groups: Iterable[Group] = self._reached.changed
        since = self._kept
        if everything or since is None:
            keys, groups, since = (key for key, _ in self.bricks), self._reached, None
        bricks = {key: self.bricks.get(key) for key in keys}
        revisions = {group: self._reached.get(group) for group in groups}
        self._changed, self._reached.changed, self._kept = set(), set(), self.bricks.revision
        return Change(since, self.bricks.revision, bricks, revisions)

    def _leave(self, taken: Taken) -> None:
        del self._taken[next(at for at, each in enumerate(self._taken) if each is taken)]

    def _check_room(self, taken: Taken) -> None:
        arena = self.bricks.arena
        wanted, free = ROOM_FACTOR * taken.bricks, self._free()
        if wanted > len(arena.deltas):
            message = f"to work the edit out takes room for {wanted} bricks; there is never more room than for"
            raise StoreFull(f"{message} {len(arena.deltas)}", bricks=wanted, slots=len(arena.deltas))
        if wanted > free and self._waiting.bricks:
            self._waiting.count()
            self._reserve(0)
            free = self._free()
        if wanted > free:
            message = f"to work the edit out takes room for {wanted} bricks; there is room for {free}"
            raise self._no_room(message, bricks=wanted, free=free)
        weight = arena.weight + arena.promised
        if weight + taken.weight > arena.weight_max:
            message = f"edits take {weight} bytes of memory, and this one {taken.weight} more"
            raise self._no_room(f"{message}; the limit is {arena.weight_max}", bytes_max=arena.weight_max)

    def _free(self) -> int:
        """Return for how many bricks there is room, beside those that edits may want which wait: of all worlds."""
        arena = self.bricks.arena
        return len(arena.deltas) - ROOM_FACTOR * arena.reserved

    def _no_room(self, message: str, **values: int) -> ChunkError:
        """Return why an edit is refused: edits that wait to be folded take more room than they will."""
        return Overloaded(message, **values) if self.bricks.arena.reserved else StoreFull(message, **values)

    def _settle(self) -> None:
        """Have the headroom go on from the bricks. It forgets edits that were dropped when none waits."""
        if not self.waiting:
            self._headroom = Headroom(self.bricks)
        else:
            self._headroom.settle(self.bricks)

    def _join(self, taken: Taken) -> None:
        self._waiting.add(taken.boxes, taken.bricks)
        self._reserve(taken.weight)

    def _reserve(self, weight: int) -> None:
        """Keep room for all bricks that may be wanted, and so many more bytes."""
        before, self._reserved = self._reserved, self._waiting.bricks
        self._promised += weight
        self.bricks.arena.reserve(self._reserved - before, weight)


def _measured(edit: Edit, bricks: Bricks, bounds: Bounds, unfolded: NDArray[np.int64], cells: int) -> Taken:
    found = narrowed(edit, bricks, bounds, unfolded)
    boxes = found.brushes.with_points()
    return _taken(found, boxes, stale(boxes, cells, bricks.lods), bricks.lods)


def _taken(edit: Edit, boxes: NDArray[np.int64], ranges: Sequence[Range], lods: int) -> Taken:
    bricks = len(bricks_met(boxes, np.arange(lods)).keys)
    return Taken(edit, boxes, ranges, GROUP_WEIGHT * groups_met(ranges), bricks)
