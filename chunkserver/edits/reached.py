"""Which edit has reached each chunk last: the chunk's own revision."""

import math
from array import array
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Final

from chunkserver.edits.boxes import Place
from chunkserver.edits.reach import Range
from chunkserver.grid import CELLS_BUILT, LATTICE_MAX, ChunkKey

GROUP_BITS: Final = 2
GROUP: Final = 1 << GROUP_BITS
"""Chunks a side whose revisions are kept together."""
GROUP_CHUNKS: Final = GROUP**3
_MOVED: Final = GROUP // 2
"""By so many chunks groups lie lower than multiples of their side: what is around the origin, as all that is edited is
on coarse levels, is in one of them and not in eight."""
GROUP_WEIGHT: Final = 8 * GROUP_CHUNKS + 256
"""Bytes that a group takes, about."""

Group = tuple[int, int, int, int]
"""A group of chunks: their level, and x, y, z of the group among groups."""

_INT64: Final = "q"
_PLACE_BITS: Final = 36
"""Of a coordinate in a packed place; they are signed, and two places are never the same number."""

_NOTHING: Final = bytes(8 * GROUP_CHUNKS)

assert array(_INT64).itemsize == 8
assert LATTICE_MAX // min(CELLS_BUILT) // GROUP < 1 << _PLACE_BITS - 1


class Reached:
    """The last revision that reached each chunk of a world. Where there is none, a chunk is pristine.

    changed: groups that were noted since this was emptied.
    groups: how many have a chunk that was reached.
    """

    def __init__(self) -> None:
        self._last: dict[int, dict[int, array[int]]] = {}
        self.groups = 0
        self.changed: set[Group] = set()

    def __iter__(self) -> Iterator[Group]:
        """Yield all groups."""
        for lod, level in self._last.items():
            for at in level:
                yield lod, *_place(at)

    def note(self, revision: int, ranges: Iterable[Range]) -> None:
        """Note an edit that is later than all before: the chunks that it made stale."""
        row = array(_INT64, [revision] * GROUP)
        for lod, low, high in ranges:
            level = self._last.setdefault(lod, {})
            spans = (_spans(*ends) for ends in zip(low, high, strict=True))
            for (x, x0, x1), (y, ys, ye), (z, zs, ze) in product(*spans):
                at = _packed(x, y, z)
                group = level.get(at)
                if group is None:
                    group = level[at] = array(_INT64, _NOTHING)
                    self.groups += 1
                self.changed.add((lod, x, y, z))
                filled = row[: x1 - x0]
                for v in range(ys, ye):
                    for w in range(zs, ze):
                        first = (v * GROUP + w) * GROUP
                        group[first + x0 : first + x1] = filled

    def last(self, key: ChunkKey) -> int:
        """Return the revision that reached a chunk last; 0 if none has."""
        level = self._last.get(key.lod)
        if not level:
            return 0
        x, y, z = key.x + _MOVED, key.y + _MOVED, key.z + _MOVED
        group = level.get(_packed(x >> GROUP_BITS, y >> GROUP_BITS, z >> GROUP_BITS))
        return group[((y % GROUP) * GROUP + z % GROUP) * GROUP + x % GROUP] if group else 0

    def get(self, group: Group) -> bytes:
        """Return the revisions of a group: (y, z, x) int64 of this machine, 0 for a chunk that was not reached."""
        lod, x, y, z = group
        return self._last[lod][_packed(x, y, z)].tobytes()

    def put(self, group: Group, revisions: bytes) -> None:
        """Take what `get` has returned of a group that is not there yet."""
        lod, x, y, z = group
        self.groups += 1
        self._last.setdefault(lod, {})[_packed(x, y, z)] = array(_INT64, revisions)


def groups_met(ranges: Iterable[Range]) -> int:
    """Return how many groups have chunks in these ranges, each range for itself."""
    sides = (
        [
            (last + _MOVED >> GROUP_BITS) - (first + _MOVED >> GROUP_BITS) + 1
            for first, last in zip(low, high, strict=True)
        ]
        for _, low, high in ranges
    )
    return int(math.fsum(map(math.prod, sides)))


def _spans(low: int, high: int) -> list[tuple[int, int, int]]:
    """Return the groups that chunks from `low` to `high` are in, along an axis; of each its first and past its last."""
    low, high = low + _MOVED, high + _MOVED
    first, last = low >> GROUP_BITS, high >> GROUP_BITS
    return [(at, max(low - at * GROUP, 0), min(high - at * GROUP + 1, GROUP)) for at in range(first, last + 1)]


def _packed(x: int, y: int, z: int) -> int:
    return x + (y << _PLACE_BITS) + (z << 2 * _PLACE_BITS)


def _place(packed: int) -> Place:
    """Return x, y, z of a packed place."""
    half = 1 << (_PLACE_BITS - 1)
    x = (packed + half) % (2 * half) - half
    rest = (packed - x) >> _PLACE_BITS
    y = (rest + half) % (2 * half) - half
    return x, y, (rest - y) >> _PLACE_BITS
