"""The edits of one world, from the moment that they are taken to their bricks; and which of them reached a chunk last.

    take -> taken -> written -> unfolded -> publish -> folded: in the bricks
                  -> dropped

Takes, writes and folds are in the same order. What an edit can change is known when it is taken, from the bricks that
there are then and from the boxes of all edits between. So it is known at any time which edit is a chunk's last, and
which is its last of those that are folded. Pure: whoever writes and folds does so elsewhere, and says when it is done.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Final, NamedTuple

from chunkserver.edits.boxes import Box
from chunkserver.edits.bricks import Bricks, Key, keys_in
from chunkserver.edits.brushes import brush
from chunkserver.edits.edit import Edit
from chunkserver.edits.effect import Bounds, changed
from chunkserver.edits.headroom import Headroom
from chunkserver.edits.reach import Range, read_ranges, stale, written
from chunkserver.edits.reached import Reached, holds
from chunkserver.errors import Overloaded, StoreFull
from chunkserver.grid import ChunkKey

UNFOLDED_MAX: Final = 4096
"""Edits that are not folded yet: beyond that, one more is refused."""
CHUNKS_MAX: Final = 1 << 22
"""That the edits of a world have reached, on all levels: half a GB."""
ROOM_FACTOR: Final = 2
"""Bricks that change are there twice while they are folded."""


class Taken(NamedTuple):
    """An edit that was taken, and may be written.

    stale: the chunks that it may change; chunks: how many. boxes: outside which it changes no delta. bricks: those that
        are written to for it.
    """

    edit: Edit
    stale: Sequence[Range]
    chunks: int
    boxes: Sequence[Box]
    bricks: frozenset[Key]

    @property
    def told(self) -> bytes:
        """What it makes stale, as JSON: a list of objects with `lod`, and the `min` and `max` of a range of chunks."""
        return written(self.stale)


class History:
    """The edits of a world, and its bricks.

    bricks: as of the last edit that is folded. revision: of the last edit that is written.
    """

    def __init__(self, bricks: Bricks, bounds: Bounds, cells: int) -> None:
        """Begin with bricks that nobody has edited. bounds: of the field, `effect.Bounds`. cells: of a chunk's side."""
        self.bricks = bricks
        self.revision = bricks.revision
        self._bounds, self._cells = bounds, cells
        self._headroom = Headroom(bricks)
        self._reached = Reached()
        self._taken: deque[Taken] = deque()
        self._unfolded: deque[Taken] = deque()
        self._chunks_pending = 0
        self._bricks_pending: Counter[Key] = Counter()

    def take(self, edit: Edit) -> Taken:
        """Return the edit with what it may change. It counts until it is dropped or folded.

        Raises `Overloaded` if too many wait to be folded, `StoreFull` if there is no room for its bricks or its chunks,
        `BadStroke` if a delta could become too large; what is known of unfolded edits is coarse, so that an edit that
        is refused for this may be taken when they are folded. Then nothing has changed.
        """
        waiting = len(self._taken) + len(self._unfolded)
        if waiting >= UNFOLDED_MAX:
            raise Overloaded(f"{waiting} edits of this world wait to be worked out", waiting=waiting)
        boxes = changed(edit, self.bricks, self._bounds, [box for taken in self._pending() for box in taken.boxes])
        taken = _taken(edit, stale(boxes, self._cells, self.bricks.lods), boxes, self.bricks.lods)
        self._check_room(taken)
        self._headroom.take(edit, self.revision + len(self._taken) + 1)
        self._taken.append(taken)
        self._count(taken, 1)
        return taken

    def logged(self, source: bytes, told: bytes) -> None:
        """Note the next edit that the log has, at a start. All of those have to be folded before another one is taken.

        source: of the edit. told: what it makes stale, as it was told then.
        """
        edit, ranges = Edit.read(source), read_ranges(told)
        boxes = [box for box in (brush(stroke).box for stroke in edit.strokes) if box.points]
        taken = _taken(edit, ranges, boxes, self.bricks.lods)
        self._count(taken, 1)
        self._unfolded.append(taken)
        self.revision += 1

    def written(self, taken: Taken, revision: int) -> None:
        """Note that the log has an edit that was taken, as `revision`: the next one of this world."""
        assert revision == self.revision + 1, f"revision {revision} follows {self.revision}"
        self._taken.remove(taken)
        self._unfolded.append(taken)
        self.revision = revision

    def dropped(self, taken: Taken) -> None:
        """Note that an edit that was taken is not written."""
        self._taken.remove(taken)
        self._count(taken, -1)

    def unfolded(self, count: int) -> list[Edit]:
        """Return the first edits, at most `count`, that are written and not folded."""
        return [taken.edit for taken in islice(self._unfolded, count)]

    def publish(self, bricks: Bricks) -> None:
        """Go on from these bricks, in which the first of the unfolded edits are."""
        for revision in range(self.bricks.revision + 1, bricks.revision + 1):
            taken = self._unfolded.popleft()
            self._reached.note(revision, taken.stale)
            self._count(taken, -1)
        self.bricks = bricks
        self._headroom.settle(bricks)

    def last_edit(self, key: ChunkKey) -> int:
        """Return the revision of the last edit that is written and has reached a chunk; 0 if none has."""
        for back, taken in enumerate(reversed(self._unfolded)):
            if holds(taken.stale, key):
                return self.revision - back
        return self.last_folded(key)

    def last_folded(self, key: ChunkKey) -> int:
        """Return the revision of the last edit that is in the bricks and has reached a chunk; 0 if none has."""
        return self._reached.last(key)

    def _pending(self) -> Iterable[Taken]:
        yield from self._unfolded
        yield from self._taken

    def _check_room(self, taken: Taken) -> None:
        arena = self.bricks.arena
        free = max(len(arena.deltas) - arena.taken - ROOM_FACTOR * arena.reserved, 0) // ROOM_FACTOR
        wanted = sum(key not in self._bricks_pending for key in taken.bricks)
        if wanted > free:
            message = f"the edit may change {wanted} bricks; there is room for {free} more"
            raise StoreFull(message, bricks=wanted, free=free)
        chunks = len(self._reached) + self._chunks_pending
        if chunks + taken.chunks > CHUNKS_MAX:
            message = f"edits have reached {chunks} chunks of this world, and this one reaches {taken.chunks} more"
            raise StoreFull(f"{message}; the limit is {CHUNKS_MAX}", chunks_max=CHUNKS_MAX)

    def _count(self, taken: Taken, by: int) -> None:
        """Count an edit that waits (by 1), or does so no longer (by -1). A brick that two of them want counts once."""
        self._chunks_pending += by * taken.chunks
        pending, before = self._bricks_pending, len(self._bricks_pending)
        for key in taken.bricks:
            pending[key] += by
            if not pending[key]:
                del pending[key]
        self.bricks.arena.reserved += len(pending) - before


def _taken(edit: Edit, ranges: Sequence[Range], boxes: Sequence[Box], lods: int) -> Taken:
    return Taken(edit, ranges, int(math.fsum(map(_chunks, ranges))), boxes, _bricks_met(edit, lods))


def _bricks_met(edit: Edit, lods: int) -> frozenset[Key]:
    """Return the bricks that are written to for an edit, on all levels."""
    met: set[Key] = set()
    for stroke in edit.strokes:
        box = brush(stroke).box
        for lod in range(lods if box.points else 0):
            met.update(keys_in(lod, box))
            box = box.coarser()
    return frozenset(met)


def _chunks(found: Range) -> int:
    _, low, high = found
    return (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1)
