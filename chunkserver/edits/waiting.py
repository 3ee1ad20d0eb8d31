"""Edits that wait to be folded: where they may change anything, and how many bricks they may want to be written to."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.pyramid import bricks_met

COUNTED_MAX: Final = 1 << 13
"""Boxes whose bricks are counted: 0.1 s. With more, whoever wants room waits until some are folded."""

_Ints = NDArray[np.int64]
_BEGIN: Final = 1 << 8
"""Boxes that there is room for at first."""


class Waiting:
    """The boxes of edits, in the order in which these were taken.

    A brick that two edits want counts twice, until that is too many for somebody and `count` finds out how many there
    are.
    """

    def __init__(self, lods: int) -> None:
        self._levels = np.arange(lods)
        self._all = np.empty((_BEGIN, 2, 3), np.int64)
        self._first = self._last = 0
        self._sum = 0
        self._counted: int | None = None
        self._has_news = True

    @property
    def boxes(self) -> _Ints:
        """All boxes: (n, 2, 3) int64, first and last point x, y, z of LOD 0. They stay as they are."""
        return self._all[self._first : self._last]

    @property
    def bricks(self) -> int:
        """How many bricks they may want, on all levels."""
        return self._sum if self._counted is None else min(self._sum, self._counted)

    def add(self, boxes: _Ints, bricks: int) -> None:
        """Add an edit. bricks: that it wants."""
        end = self._last + len(boxes)
        if end > len(self._all):
            kept = self.boxes  # whoever has these goes on reading the old array
            self._all = np.empty((2 * (len(kept) + len(boxes)) + _BEGIN, 2, 3), np.int64)
            self._all[: len(kept)] = kept
            self._first, self._last, end = 0, len(kept), len(kept) + len(boxes)
        self._all[self._last : end] = boxes
        self._last = end
        self._sum += bricks
        self._has_news = True
        if self._counted is not None:
            self._counted += bricks

    def leave(self, boxes: _Ints, bricks: int) -> None:
        """Take the first edit away."""
        self._first += len(boxes)
        self._leave(bricks)

    def drop(self, bricks: int, others: Sequence[_Ints]) -> None:
        """Take any edit away. bricks: that it wanted. others: the boxes of those that stay."""
        self._all, self._first = np.concatenate([self._all[:0], *others]), 0
        self._last = len(self._all)
        self._leave(bricks)

    def count(self) -> None:
        """Find out how many bricks they want, unless they are those of the last time, or it would take too long."""
        boxes = self.boxes
        if self._has_news and len(boxes) <= COUNTED_MAX:
            self._has_news, self._counted = False, len(bricks_met(boxes, self._levels).keys)

    def _leave(self, bricks: int) -> None:
        self._sum -= bricks
        self._has_news = True
        if self._first == self._last:
            self._counted = None
