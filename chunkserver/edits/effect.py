"""Where an edit can change anything: known before it is folded, from bounds of the field and of the deltas so far.

The box of a carve or fill is cut into parts. What is nearest to the shape in a part, and what the field and the deltas
lie between there, may show that the stroke changes nothing in it. Errs on the large side only.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS
from chunkserver.edits.bricks import Bricks
from chunkserver.edits.brushes import ADD, CARVE, DELTA, FILL, STRENGTH, Brushes, write_distances
from chunkserver.edits.cubes import met
from chunkserver.edits.edit import Edit
from chunkserver.edits.strokes import FIELD_MAX, UNITS_PER_VOXEL, Delta

SIDE: Final = 4
"""A stroke's box is looked at in so many parts along each axis."""
PARTS: Final = SIDE**3
SLACK: Final = 2.0**-10
"""Voxels: more than what the rounding of a distance or of a part's border comes to, 2^41 voxels across."""

_LIMIT: Final = float(FIELD_MAX)
_NOWHERE: Final = np.array([[1], [0]])
_EVEN: Final = np.arange(0, 2 * SIDE, 2)
_STEPS: Final = np.arange(float(SIDE))
_PLACES: Final = np.array([[0, 0, 0], [SIDE - 1, SIDE - 1, SIDE - 1]])

_Doubles = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Numbers = NDArray[np.int32]
_Flags = NDArray[np.bool_]

Bounds = Callable[[_Doubles, _Doubles], tuple[_Doubles, _Doubles]]
"""What the field of LOD 0 lies between before any edit. Takes low and high corners of n boxes, (3, n) float64, x y z,
voxels; returns lowest and highest density of each, (n,) float64, voxels; infinite where it is not known."""


def changed(edit: Edit, bricks: Bricks, bounds: Bounds, unfolded: Sequence[_Ints] = ()) -> _Ints:
    """Return boxes of lattice points of LOD 0: outside them the edit changes no delta. None where it changes nothing.

    bricks: the deltas that are known. unfolded: boxes outside which they are right: what this has returned for the
        edits that come before this one and are not in the bricks yet.

    Returns (n, 2, 3) int64: first and last point x, y, z of each.
    """
    of = edit.brushes
    does = (of.points() > 0) & _weighs(of)
    cuts = np.flatnonzero(does & (of.ops <= FILL))
    known = np.concatenate([*unfolded, of.boxes]) if len(cuts) else of.boxes.copy()
    boxes = known[len(known) - len(of.boxes) :]
    boxes[~does] = _NOWHERE
    for n in np.flatnonzero(of.ops == DELTA).tolist():
        stroke = edit.strokes[n]
        assert isinstance(stroke, Delta)
        _tighten_values(stroke.deltas(), boxes[n])
    if len(cuts):
        _tighten_cuts(cuts, of, known, bricks, bounds)
    return boxes[(boxes[:, 0] <= boxes[:, 1]).all(axis=1)]


def _weighs(of: Brushes) -> _Flags:
    """Return which strokes do anything where they are strongest: (n,) bool, True for those that have no strength."""
    strength = of.numbers[:, STRENGTH]
    does = np.where(of.ops == ADD, np.floor(strength * UNITS_PER_VOXEL + 0.5) != 0.0, strength > 0.0)
    return np.asarray(does | (of.ops <= FILL) | (of.ops == DELTA))


def _tighten_values(values: _Numbers, box: _Ints) -> None:
    """Make a delta's box, (2, 3) in and out, as small as those of its values that are not 0."""
    if not values.any():
        box[:] = _NOWHERE
        return
    for axis, others in ((0, (0, 1)), (1, (1, 2)), (2, (0, 2))):
        box[:, axis] = box[0, axis] + np.flatnonzero(values.any(axis=others))[[0, -1]]


def _tighten_cuts(cuts: _Ints, of: Brushes, boxes: _Ints, bricks: Bricks, bounds: Bounds) -> None:
    """Make boxes of carves and fills as small as all their parts in which a delta can change.

    cuts: which strokes these are. boxes: those outside which deltas are known, then those of all strokes, in and out.
    """
    nearest, low, high = _parts(of.part(cuts))
    lowest, highest = (found.reshape(nearest.shape) for found in bounds(low.reshape(3, -1), high.reshape(3, -1)))
    least, most = _known(of.boxes[cuts], low, high, bricks)
    carved = (-nearest - np.maximum(lowest, -_LIMIT)) * UNITS_PER_VOXEL >= least
    filled = (nearest - np.minimum(highest, _LIMIT)) * UNITS_PER_VOXEL <= most
    flags = np.where(of.ops[cuts, None] == CARVE, carved, filled)
    for n, at in enumerate((len(boxes) - len(of.ops) + cuts).tolist()):
        box, first, last = boxes[at], low[:, n], high[:, n]
        near = boxes[:at][((boxes[:at, 0] <= box[1]) & (boxes[:at, 1] >= box[0])).all(axis=1)]
        where = flags[n]
        if len(near):
            meets = (near[:, 0, :, None] <= last) & (near[:, 1, :, None] >= first)
            where = where | meets.all(axis=1).any(axis=0)
        if where.any():
            box[0] = np.maximum(box[0], np.ceil(first[:, where].min(axis=1)))
            box[1] = np.minimum(box[1], np.floor(last[:, where].max(axis=1)))
        else:
            box[:] = _NOWHERE


def _parts(of: Brushes) -> tuple[_Doubles, _Doubles, _Doubles]:
    """Return how near the shape is to each part of its stroke's box at least, (n, PARTS), and low and high corners.

    Corners are (3, n, PARTS), x, y, z; parts are in the order (y, z, x).
    """
    count = len(of.ops)
    begin = of.boxes[:, 0].astype(np.float64)
    side = (of.boxes[:, 1] - begin) / SIDE
    nearest, low, high = np.empty((count, PARTS)), *np.empty((2, 3, count, SIDE, SIDE, SIDE))
    middles = (begin - of.numbers[:, :3] + 0.5 * side)[:, :, None] + side[:, :, None] * _STEPS
    for axis, spread in ((0, (-1, 1, 1, SIDE)), (1, (-1, SIDE, 1, 1)), (2, (-1, 1, SIDE, 1))):
        edges = begin[:, axis, None] + side[:, axis, None] * _STEPS
        low[axis] = (edges - SLACK).reshape(spread)
        high[axis] = (edges + (side[:, axis, None] + SLACK)).reshape(spread)
    for n, shape in enumerate(of.shapes.tolist()):
        write_distances(shape, of.numbers[n], middles[n], _PLACES, nearest[n])
    nearest -= 0.5 * np.sqrt((side * side) @ np.ones(3))[:, None] + SLACK
    return nearest, low.reshape(3, count, PARTS), high.reshape(3, count, PARTS)


def _known(boxes: _Ints, low: _Doubles, high: _Doubles, bricks: Bricks) -> tuple[_Ints, _Ints]:
    """Return what deltas lie between in each part of boxes, so far as bricks know: (n, PARTS) int64."""
    cubes = met(np.zeros(len(boxes), np.int64), boxes, BRICK_BITS)
    found = [(brick.low, brick.high) if brick else (0, 0) for brick in map(bricks.get, cubes.places())]
    least, most = np.zeros((2, len(boxes), PARTS), np.int64)
    if any(map(any, found)):
        ends = np.array(found)[cubes.grids]
        for n, start in enumerate(cubes.starts.tolist()):
            least[n], most[n] = _of_parts(ends[start:], boxes[n], low[:, n], high[:, n])
    return least, most


def _of_parts(ends: _Ints, box: _Ints, low: _Doubles, high: _Doubles) -> tuple[_Ints, _Ints]:
    """Return what deltas lie between in each part of a box. ends: (bricks or more, 2), of each brick, (y, z, x)."""
    x, y, z = (np.diff(box >> BRICK_BITS, axis=0)[0] + 1).tolist()
    lows, highs = ends[: x * y * z].reshape(y, z, x, 2).transpose(3, 0, 1, 2)
    for axis, (of, step) in enumerate(((1, SIDE * SIDE), (2, SIDE), (0, 1))):
        first, last = box[:, of]
        spans = np.empty(2 * SIDE, np.int64)
        spans[::2] = np.clip(np.floor(low[of, : step * SIDE : step]), first, last)
        spans[1::2] = np.clip(np.ceil(high[of, : step * SIDE : step]), first, last)
        spans = (spans >> BRICK_BITS) - (first >> BRICK_BITS)
        spans[1::2] += 1
        lows = np.minimum.reduceat(_padded(lows, axis), spans, axis).take(_EVEN, axis)
        highs = np.maximum.reduceat(_padded(highs, axis), spans, axis).take(_EVEN, axis)
    return lows.reshape(-1), highs.reshape(-1)


def _padded(values: _Ints, axis: int) -> _Ints:
    """Return the values with the last ones once more: `reduceat` takes no end beyond the last."""
    return np.concatenate([values, values.take([-1], axis)], axis)
