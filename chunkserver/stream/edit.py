"""An edit that is durable, in all the ways in which it is told; each is worked out once for all who are told."""

from collections.abc import Iterable
from functools import cached_property
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.stream.limits import FRAME_BYTES_MAX, LODS_MAX
from chunkserver.stream.ranges import bounded, read_ranges, written
from chunkserver.stream.regions import Box, Regions

HEAD_BYTES_MAX: Final = 256
"""What a message of edits has beside edits and ranges."""
PAIRS_MAX: Final = 256
"""Edits times regions that are looked at one by one, which is faster for few."""
_NOWHERE: Final = Box((1 << 62, 1 << 62, 1 << 62), (-1 << 62, -1 << 62, -1 << 62))
"""It meets nothing, and joined with a box it is that box."""


class StreamEdit:
    """An edit as the log has it.

    ranges: the chunks that it may have changed, in a bounded number of ranges.
    weight: bytes that it takes about.
    """

    def __init__(
        self,
        revision: int,
        strokes: bytes,
        stale: bytes,
        cells: int,
        client: str | None = None,
        seq: int | None = None,
    ) -> None:
        """Take an edit as the log has it.

        revision: of the edit. strokes: JSON, a list. stale: JSON, the ranges of chunks that its sender was answered.
        cells: of a side of the world's chunks. client, seq: who sent it on a stream, and under which number.
        """
        self.revision = revision
        self.client = client
        self.seq = seq
        self.ranges = bounded(read_ranges(stale))
        self.weight = len(strokes) + len(stale)
        self._strokes = strokes if len(strokes) < FRAME_BYTES_MAX else b"null"
        self._cells = cells

    @cached_property
    def pieces(self) -> tuple[bytes, ...]:
        """Its ranges as JSON, one by one."""
        return tuple(map(written, self.ranges))

    @cached_property
    def item(self) -> bytes:
        """Its place in a message of edits, as JSON. Strokes for which no message has room are null there."""
        head = b'{"revision":"%d","strokes":' % self.revision
        room = FRAME_BYTES_MAX - HEAD_BYTES_MAX - len(head) - length(self.pieces)
        return head + (self._strokes if len(self._strokes) < room else b"null") + b"}"

    def is_in(self, regions: Regions) -> bool:
        """Return whether it may have changed a chunk that matters in one of the regions."""
        bounds = self._bounds
        last = len(bounds) - 1
        return any(bounds[min(lod, last)].meets(box) and self._meets(box, lod) for box, lod in regions)

    def _meets(self, box: Box, lod: int) -> bool:
        return any(at <= lod and voxels.meets(box) for at, voxels in self._voxels)

    @cached_property
    def corners(self) -> NDArray[np.int64]:
        """(LODS_MAX, 2, 3) int64, voxels: of each level the low and the high corner of a box around all that it reaches
        there and on finer ones.
        """
        found = np.array(self._bounds, np.int64)
        return found[np.minimum(np.arange(LODS_MAX), len(found) - 1)]

    @cached_property
    def _voxels(self) -> tuple[tuple[int, Box], ...]:
        return tuple((each.lod, each.voxels(self._cells)) for each in self.ranges)

    @cached_property
    def _bounds(self) -> list[Box]:
        """Of each level that it reaches, a box of voxels around all ranges of this level and finer ones."""
        levels = [_NOWHERE] * (1 + max((each.lod for each in self.ranges), default=0))
        for lod, box in self._voxels:
            levels[lod] = levels[lod].joined(box)
        return list(accumulate(levels, Box.joined))


StreamEdits = tuple[StreamEdit, ...]


def edits_in(edits: StreamEdits, regions: Regions) -> StreamEdits:
    """Return those of some edits that are in the regions: see `StreamEdit.is_in`.

    Many are compared together: else who resumes with 64 regions 4096 edits back has all others wait for 130 ms.
    """
    if len(edits) * len(regions) <= PAIRS_MAX:
        return tuple(edit for edit in edits if edit.is_in(regions))
    bounds = np.stack([edit.corners for edit in edits])
    near = np.zeros(len(edits), bool)
    for lod in {region.lod for region in regions}:
        boxes = np.array([region.box for region in regions if region.lod == lod], np.int64)
        low, high = bounds[:, lod, 0, None], bounds[:, lod, 1, None]
        meets = (low <= boxes[:, 1]) & (boxes[:, 0] <= high)
        near |= np.any(np.all(meets, axis=2), axis=1)
    return tuple(edits[at] for at in np.flatnonzero(near) if edits[at].is_in(regions))


def length(pieces: Iterable[bytes]) -> int:
    """Return how many bytes pieces of JSON take in a list, a comma each."""
    return sum(len(piece) + 1 for piece in pieces)
