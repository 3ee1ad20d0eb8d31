"""One level of a cut through an octree, as arrays over the boxes of chunks that matter.

Chunks are there where their parent is split. Those that are not split are the leaves: the cut.

    . . . .        . . . . . . . .        . not there    # split    o leaf
    . o # .        . . . . . . . .
    . o o .        . . . . o # . .        Around what is there is a margin, so that what is
    . . . .        . . . . o o . .        beside a chunk can always be looked up.
    level n        . . . . . . . .
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver_client.mesh import ChunkKey, Triple

FACES: Final = 6
"""Of a chunk, and bits of a mask of them: -x +x -y +y -z +z."""

Flags = NDArray[np.bool_]
Squares = NDArray[np.float64]


class FittedChunk(NamedTuple):
    """A chunk, and which of its faces have to fit a coarser one: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32."""

    lod: int
    x: int
    y: int
    z: int
    coarser: int

    @property
    def key(self) -> ChunkKey:
        """Which chunk it is."""
        return ChunkKey(*self[:4])


class Box(NamedTuple):
    """A box in voxels, both ends included."""

    low: Triple
    high: Triple


class Frame(NamedTuple):
    """Which chunks an array (x, y, z) is about. low: the first one, in chunks. side: of each, in voxels."""

    lod: int
    side: int
    low: Triple
    shape: Triple

    def starts(self) -> list[NDArray[np.int64]]:
        """Return by axis where each chunk begins, in voxels."""
        return [
            np.arange(low, low + count, dtype=np.int64) * self.side
            for low, count in zip(self.low, self.shape, strict=True)
        ]

    def squared_distances(self, viewer: Box) -> Squares:
        """Return the square of the distance from the viewer to each chunk's box; 0 where they meet."""
        gaps = (
            np.maximum(np.maximum(start - high, low - (start + self.side)), 0).astype(np.float64)
            for start, low, high in zip(self.starts(), *viewer, strict=True)
        )
        x, y, z = (gap * gap for gap in gaps)
        squares: Squares = x[:, None, None] + y[:, None] + z
        return squares

    def inside(self, box: Box) -> Flags:
        """Return which chunks have some of a box in them."""
        x, y, z = (
            (start < high) & (start + self.side > low) for start, low, high in zip(self.starts(), *box, strict=True)
        )
        flags: Flags = x[:, None, None] & y[:, None] & z
        return flags


class Marks(NamedTuple):
    """Some chunks of a level."""

    frame: Frame
    flags: Flags

    def over(self, frame: Frame) -> Flags:
        """Return them as an array over another frame of their level."""
        flags = np.zeros(frame.shape, np.bool_)
        here, there = [], []
        for low, count, own_low, own_count in zip(*frame[2:], *self.frame[2:], strict=True):
            first, end = max(low, own_low), min(low + count, own_low + own_count)
            here.append(slice(max(first - low, 0), max(end - low, 0)))
            there.append(slice(max(first - own_low, 0), max(end - own_low, 0)))
        flags[tuple(here)] = self.flags[tuple(there)]
        return flags

    def upwards(self) -> "Marks":
        """Return the parents of all chunks that are, or touch, one of these. The frame begins and ends between parents.

        Along an axis, parent i has the children 2i and 2i + 1, and touches 2i - 1 and 2i + 2.
        """
        flags = self.flags
        for _ in range(3):
            even, odd = flags[::2], flags[1::2]
            pairs = even | odd
            pairs[1:] |= odd[:-1]
            pairs[:-1] |= even[1:]
            flags = pairs.transpose(1, 2, 0)  # three times: as it was
        low_x, low_y, low_z = (low // 2 for low in self.frame.low)
        return Marks(Frame(self.frame.lod + 1, self.frame.side * 2, (low_x, low_y, low_z), flags.shape), flags)


@dataclass(eq=False, frozen=True)
class Layer:
    """One level of a cut.

    above: who is split there; of the last level, who is within reach. marks: who is split here, and may not be there.
    there: who is. split: who of them is split. coarser: where the leaves above are.
    """

    above: "Marks | Layer"
    marks: Marks
    frame: Frame
    there: Flags
    split: Flags
    coarser: Flags

    @cached_property
    def leaves(self) -> Flags:
        """Which chunks are there and not split."""
        return self.there & ~self.split

    @cached_property
    def chunks(self) -> frozenset[FittedChunk]:
        """The leaves."""
        at = np.argwhere(self.leaves)
        rows = np.empty((len(at), 5), np.int64)
        rows[:, 0] = self.frame.lod
        rows[:, 1:4] = at + self.frame.low
        rows[:, 4] = 0
        for face in range(FACES):
            beside = at.T.copy()
            beside[face // 2] += 1 if face & 1 else -1
            rows[:, 4] |= self.coarser[tuple(beside)].astype(np.int64) << face
        return frozenset(map(FittedChunk._make, rows.tolist()))

    @cached_property
    def counts(self) -> tuple[int, int]:
        """How many chunks are leaves, and how many are split."""
        return int(np.count_nonzero(self.leaves)), int(np.count_nonzero(self.split))


def last_layer(roots: Marks, split: Marks, before: Layer | None) -> Layer:
    """Return the layer of the last level; the one before, if it is the same: its chunks may be known."""
    if before is not None and before.above is roots and before.marks is split:
        return before
    frame, there = roots
    return Layer(roots, split, frame, there, split.over(frame) & there, np.zeros(frame.shape, np.bool_))


def next_layer(above: Layer, split: Marks, box: Box, before: Layer | None) -> Layer:
    """Return the layer below one in which something is split; the one before, if it is the same."""
    if before is not None and before.above is above and before.marks is split:
        return before
    low, shape, crop = [], [], []
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        at = np.flatnonzero(above.split.any(axis=others))
        first, end = int(at[0]) - 1, int(at[-1]) + 2
        low.append(2 * (above.frame.low[axis] + first))
        shape.append(2 * (end - first))
        crop.append(slice(first, end))
    lod, side, *_ = above.frame
    frame = Frame(lod - 1, side // 2, (low[0], low[1], low[2]), (shape[0], shape[1], shape[2]))
    there = _doubled(above.split[tuple(crop)]) & frame.inside(box)
    return Layer(above, split, frame, there, split.over(frame) & there, _doubled(above.leaves[tuple(crop)]))


def _doubled(flags: Flags) -> Flags:
    return flags.repeat(2, 0).repeat(2, 1).repeat(2, 2)
