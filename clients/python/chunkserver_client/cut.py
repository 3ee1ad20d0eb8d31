"""A cut through the octree of a world, for one viewer: docs/level-of-detail.md.

Upwards, from the finest level: who is near enough to be split, and whom the balance makes split for it. Downwards: what
that leaves, level by level.
"""

import math
from dataclasses import dataclass
from itertools import zip_longest
from typing import Final, NamedTuple

import numpy as np

from chunkserver_client.ladder import Rung, kept
from chunkserver_client.layers import Box, FittedChunk, Flags, Frame, Layer, Marks, last_layer, next_layer
from chunkserver_client.mesh import Triple

MARGIN: Final = 3
"""Chunks around those that are near: two that the balance may split, and the ring around these."""
ROUNDED: Final = 2.0**-6
"""Voxels by which a distance is mistrusted before it says that nothing has changed: more than float64 can be off."""


class Viewer(NamedTuple):
    """Somebody who is somewhere, and on the way to somewhere else. Voxels."""

    at: Triple
    ahead: Triple

    def box(self, ahead_max: int) -> Box:
        """Return the box between here and there; no further ahead than that, on each axis."""
        ends = [
            sorted((at, at + max(-ahead_max, min(ahead, ahead_max))))
            for at, ahead in zip(self.at, self.ahead, strict=True)
        ]
        (ax, bx), (ay, by), (az, bz) = ends
        return Box((ax, ay, az), (bx, by, bz))

    def moved(self, other: "Viewer") -> float:
        """Return by how much no distance to these two can differ more."""
        return math.hypot(*(abs(a - c) + abs(b - d) for a, b, c, d in zip(*other, *self, strict=True)))


@dataclass(eq=False, frozen=True, slots=True)
class Level:
    """Who of a level is marked, for a viewer who asks for all within a distance.

    slack: how far the viewer may move, in voxels, before that changes.
    """

    marks: Marks
    distance: int
    viewer: Viewer
    slack: float

    def holds(self, distance: int, viewer: Viewer) -> bool:
        """Return whether nothing can have changed."""
        still = viewer == self.viewer or viewer.moved(self.viewer) + ROUNDED < self.slack
        return still and distance == self.distance


@dataclass(eq=False, frozen=True, slots=True)
class Cut:
    """What one viewer is shown.

    roots: who of the last level is there. split: by LOD, who is split. layers: the last level first.
    """

    roots: Level
    split: tuple[Level, ...]
    layers: tuple[Layer, ...]

    def chunks(self) -> frozenset[FittedChunk]:
        """Return the chunks of all levels."""
        return frozenset[FittedChunk]().union(*(layer.chunks for layer in self.layers))


class Octree(NamedTuple):
    """All chunks of a world. sides: by LOD, in voxels. box: in voxels; chunks have some of it in them."""

    sides: list[int]
    box: Box

    def cut(self, rung: Rung, viewer: Viewer, before: Cut | None, count_max: int) -> Cut | None:
        """Return the cut for a viewer, which depends on the one before; None if it has more than `count_max` chunks.

        Parts that cannot have changed are those of `before`, the same objects.
        """
        roots = self._roots(rung.reach, viewer, None if before is None else before.roots)
        same = before is not None and before.roots.marks is roots.marks
        split: list[Level] = []
        for lod, distance in enumerate(rung.split):
            was = None if before is None else before.split[lod]
            if not (same and was is not None and was.holds(distance, viewer)):
                was = self._split(lod, distance, viewer, roots.marks, split[-1].marks if split else None, was)
            same = same and before is not None and before.split[lod].marks is was.marks
            split.append(was)
            if np.count_nonzero(was.marks.flags) > count_max:
                return None
        layers = self._layers(roots.marks, split, () if before is None else before.layers, count_max)
        return None if layers is None else Cut(roots, tuple(split), layers)

    def _roots(self, reach: int, viewer: Viewer, before: Level | None) -> Level:
        """Return who of the last level is there."""
        if before is not None and before.holds(reach, viewer):
            return before
        frame = self._frame(len(self.sides) - 1, viewer.box(reach), reach)
        return _level(frame, frame.inside(self.box), reach, viewer, before, None)

    def _split(
        self, lod: int, distance: int, viewer: Viewer, roots: Marks, finer: Marks | None, before: Level | None
    ) -> Level:
        """Return who of a level is split, being near or for the balance. finer: who is split in the level below."""
        frame = self._frame(lod, viewer.box(distance), distance)
        if finer is None or not distance:
            return Level(_same(Marks(frame, np.zeros(frame.shape, np.bool_)), before), distance, viewer, math.inf)
        exists = frame.inside(self.box) & self._below(roots, frame)
        return _level(frame, exists, distance, viewer, before, finer.upwards())

    def _layers(
        self, roots: Marks, split: list[Level], before: tuple[Layer, ...], count_max: int
    ) -> tuple[Layer, ...] | None:
        """Return what is there, the last level first; None if there is more than `count_max`."""
        layers: list[Layer] = []
        count = 0
        for level, old in zip_longest(reversed(split), before[: len(split)]):
            layer = (
                next_layer(layers[-1], level.marks, self.box, old) if layers else last_layer(roots, level.marks, old)
            )
            layers.append(layer)
            leaves, inner = layer.counts
            count += leaves
            if count + inner > count_max:
                return None
            if not inner:
                break
        return tuple(layers)

    def _frame(self, lod: int, viewer: Box, distance: int) -> Frame:
        """Return a frame around all that a level can have split for a viewer. It begins and ends between parents."""
        side = self.sides[lod]
        low, shape = [], []
        for near, far, least, most in zip(*viewer, *self.box, strict=True):
            first = max((near - kept(distance)) // side - MARGIN, least // side - 1)
            end = min((far + kept(distance)) // side + MARGIN, -(-most // side)) + 1
            low.append(first - first % 2)
            shape.append(max(end + end % 2 - low[-1], 0))
        return Frame(lod, side, (low[0], low[1], low[2]), (shape[0], shape[1], shape[2]))

    def _below(self, roots: Marks, frame: Frame) -> Flags:
        """Return which chunks of a frame lie in a chunk of the last level that is there."""
        if 0 in roots.frame.shape:
            return np.zeros(frame.shape, np.bool_)
        levels = len(self.sides) - 1 - frame.lod
        at = [
            np.clip((np.arange(low, low + count) >> levels) - first, 0, most - 1)
            for low, count, first, most in zip(*frame[2:], *roots.frame[2:], strict=True)
        ]
        flags: Flags = roots.flags[np.ix_(*at)]
        return flags


def _level(
    frame: Frame, exists: Flags, distance: int, viewer: Viewer, before: Level | None, balance: Marks | None
) -> Level:
    """Mark who is near, or was marked and is only a quarter further away, or is marked for the balance."""
    keep = kept(distance)
    squares = frame.squared_distances(viewer.box(distance))
    within = squares < float(keep) ** 2
    marked = squares < float(distance) ** 2
    if before is not None:
        marked |= before.marks.over(frame) & within
    if balance is not None:
        marked |= balance.over(frame)
    marked &= exists
    nearest = squares[exists & ~marked].min(initial=math.inf)
    farthest = squares[marked & within].max(initial=0.0)
    slack = min(math.sqrt(nearest) - distance, keep - math.sqrt(farthest), float(frame.side))
    return Level(_same(Marks(frame, marked), before), distance, viewer, slack)


def _same(marks: Marks, before: Level | None) -> Marks:
    """Return the marks of before if they are the same."""
    if before is None or before.marks.frame != marks.frame or not np.array_equal(before.marks.flags, marks.flags):
        return marks
    return before.marks
