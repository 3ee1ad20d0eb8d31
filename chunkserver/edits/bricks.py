"""The deltas of one world at one revision, on all levels: a fold of its edits, which can be worked out again from them.

A `Bricks` never changes, so it may be read while the next one is being made. `apply` copies the bricks that it writes
and shares all others, and works the coarser levels out once for all edits that it takes, only where something changed.
"""

from collections.abc import Iterator, Mapping, Sequence

from chunkserver.edits.arena import Arena, Brick
from chunkserver.edits.boxes import Box, Place
from chunkserver.edits.draft import Draft
from chunkserver.edits.edit import Edit
from chunkserver.edits.keys import Key, hold, keys_in
from chunkserver.edits.reading import Reading
from chunkserver.edits.runs import Field
from chunkserver.edits.shared_map import SharedMap
from chunkserver.grid import LOD_MAX


class Bricks:
    """All bricks of a world at one revision. Where there is none, deltas are 0.

    lods: how many levels there are. arena: where they lie; a new one if none is given. revision: of the last edit.
    changed: keys of the bricks that `apply` has made, changed or dropped, if these are by it.
    """

    def __init__(self, lods: int = LOD_MAX + 1, arena: Arena | None = None, revision: int = 0) -> None:
        self.lods = lods
        self.arena = Arena() if arena is None else arena
        self.revision = revision
        self.changed: frozenset[Key] = frozenset()
        self._at: SharedMap[Key, Brick] = SharedMap()

    @classmethod
    def kept(cls, bricks: Mapping[Key, Brick], revision: int, lods: int, arena: Arena) -> "Bricks":
        """Return all bricks of a revision, which lie in `arena`."""
        found = cls(lods, arena, revision)
        found._at = found._at.changed(bricks)
        return found

    def __len__(self) -> int:
        return len(self._at)

    def __iter__(self) -> Iterator[tuple[Key, Brick]]:
        """Yield all bricks with their keys."""
        yield from self._at

    def get(self, key: Key) -> Brick | None:
        """Return a brick; None where all deltas are 0."""
        return self._at.get(key)

    def read(self, lod: int, low: Place, shape: tuple[int, int, int]) -> Reading:
        """Return what is to be added to the densities of a box of lattice points.

        low: x, y, z of the first, in steps of the level. shape: how many, (y, z, x).

        The bricks stay where they are for as long as it is kept. Raises `StoreFull` if there is no room for them.
        """
        (planes, rows, width), (x, y, z) = shape, low
        box = Box(low, (x + width - 1, y + planes - 1, z + rows - 1))
        get = self._at.get
        bricks = [get(key) for key in keys_in(lod, box)]
        there = [brick for brick in bricks if brick]
        lowest, highest = min([0, *[brick.low for brick in there]]), max([0, *[brick.high for brick in there]])
        slots, place, held = hold(bricks, box)
        return Reading(slots, place, lowest, highest, held)

    def apply(self, edits: Sequence[Edit], revision: int, field: Field) -> "Bricks":
        """Return the bricks after some more edits, in their order; those before do not change.

        revision: of the last of them.

        Raises `StoreFull` if the arena has no room, and whatever `field` raises: then nothing has happened.
        """
        draft = Draft(self._at.of, self.arena, field)
        draft.fold(edits)
        draft.filter_up(self.lods)
        fresh = draft.settled()
        after = Bricks(self.lods, self.arena, revision)
        after._at = self._at.changed(fresh)
        after.changed = frozenset(fresh)
        return after
