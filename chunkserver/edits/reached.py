"""Which edit has reached each chunk last: the chunk's own revision."""

import math
from collections.abc import Iterable
from typing import Final

from chunkserver.edits.reach import Range
from chunkserver.grid import CELLS_BUILT, LATTICE_MAX, ChunkKey

_PLACE_BITS: Final = 38
"""Of a coordinate in a packed key; they are signed, and two keys are never the same number."""

assert LATTICE_MAX // min(CELLS_BUILT) < 1 << _PLACE_BITS - 1


class Reached:
    """The last revision that reached each chunk of a world. Where there is none, a chunk is pristine."""

    def __init__(self) -> None:
        self._last: dict[int, dict[int, int]] = {}

    def __len__(self) -> int:
        """Return how many chunks were reached, on all levels."""
        return int(math.fsum(map(len, self._last.values())))

    def note(self, revision: int, ranges: Iterable[Range]) -> None:
        """Note an edit that is later than all before: the chunks that it made stale."""
        for lod, low, high in ranges:
            level = self._last.setdefault(lod, {})
            for z in range(low[2], high[2] + 1):
                for y in range(low[1], high[1] + 1):
                    row = _packed(low[0], y, z)
                    level.update(dict.fromkeys(range(row, row + high[0] - low[0] + 1), revision))

    def last(self, key: ChunkKey) -> int:
        """Return the revision that reached a chunk last; 0 if none has."""
        lod, x, y, z = key
        level = self._last.get(lod)
        return level.get(_packed(x, y, z), 0) if level else 0


def _packed(x: int, y: int, z: int) -> int:
    return x + (y << _PLACE_BITS) + (z << 2 * _PLACE_BITS)


def holds(ranges: Iterable[Range], key: ChunkKey) -> bool:
    """Return whether a chunk is in one of the ranges."""
    lod, x, y, z = key
    return any(
        at == lod and low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]
        for at, low, high in ranges
    )
