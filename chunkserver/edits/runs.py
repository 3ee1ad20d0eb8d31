"""The strokes of many edits in runs that are folded at once, with what they need beside their numbers."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.boxes import Box
from chunkserver.edits.brushes import FILL, Brushes
from chunkserver.edits.edit import Edit
from chunkserver.edits.strokes import Stroke

RUN_POINTS: Final = 1 << 20
"""Lattice points of the strokes of a run, about: one stroke may have four times as many."""

Field = Callable[[Box], NDArray[np.float32]]
"""The densities of LOD 0 before any edit over a box: (y, z, x) float32, C order, voxels, within FIELD_MAX."""

_Ints = NDArray[np.int64]
_NO_FIELD: Final = np.empty(0, np.float32)


class Run(NamedTuple):
    """Strokes that follow each other, all with a point that they may change; or one that is worked out alone.

    field: (n,) float32, voxels, over the boxes of carves and fills, (y, z, x), one stroke after the other.
    starts: (strokes,) int64, where those of a stroke begin.
    """

    strokes: Sequence[Stroke]
    of: Brushes
    field: NDArray[np.float32]
    starts: _Ints


def runs(edits: Sequence[Edit], field: Field) -> Iterator[Run]:
    """Yield all strokes of edits that may change a point, in their order."""
    if not edits:
        return
    of = Brushes.joined([edit.brushes for edit in edits])
    points = of.points()
    which = np.flatnonzero(points)
    strokes = [stroke for edit in edits for stroke in edit.strokes]
    alone = np.cumsum(of.alone()[which])
    number = np.cumsum(points[which]) // RUN_POINTS + alone + np.concatenate([[0], alone[:-1]])
    for run in np.split(which, np.flatnonzero(np.diff(number)) + 1) if len(which) else ():
        part = of.part(run)
        cuts = part.ops <= FILL
        counts = points[run].astype(np.int64) * cuts
        boxes = [Box((x, y, z), (u, v, w)) for (x, y, z), (u, v, w) in part.boxes[cuts].tolist()]
        densities = np.concatenate([_NO_FIELD, *_densities(boxes, field)])
        yield Run([strokes[n] for n in run.tolist()], part, densities, np.cumsum(counts) - counts)


def _densities(boxes: Sequence[Box], field: Field) -> list[NDArray[np.float32]]:
    """Return the densities of each box, flat. Neighbours in the list are sampled at once where that is no more work."""
    found: list[NDArray[np.float32]] = []
    at = 0
    while at < len(boxes):
        first, cluster = at, boxes[at]
        while (at := at + 1) < len(boxes):
            joined = cluster.joined(boxes[at])
            if joined.points > min(cluster.points + boxes[at].points, RUN_POINTS):
                break
            cluster = joined
        sampled = field(cluster)
        found += [sampled[box.part_of(cluster)].reshape(-1) for box in boxes[first:at]]
    return found
