"""Where an edit can change anything: known before it is folded, from bounds of the field and of the deltas so far.

A stroke's box is cut into parts. What is nearest to the shape in a part, and what the field and the deltas lie between
there, may show that the stroke changes nothing in it. Errs on the large side only.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS
from chunkserver.edits.boxes import Box
from chunkserver.edits.bricks import Bricks, keys_in
from chunkserver.edits.brushes import Brush, brush, distances
from chunkserver.edits.edit import Edit
from chunkserver.edits.strokes import FIELD_MAX, UNITS_PER_VOXEL, Add, Carve, Delta, Fill, Flatten, Smooth, Stroke

PARTS: Final = 4
"""A stroke's box is looked at in so many parts along each axis."""
SLACK: Final = 2.0**-10
"""Voxels: more than what the rounding of a distance or of a part's border comes to, 2^41 voxels across."""

_FIRST: Final = np.arange(PARTS)
_LAST: Final = np.arange(1, PARTS + 1)

_Doubles = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Flags = NDArray[np.bool_]

Bounds = Callable[[_Doubles, _Doubles], tuple[_Doubles, _Doubles]]
"""What the field of LOD 0 lies between before any edit. Takes low and high corners of n boxes, (3, n) float64, x y z,
voxels; returns lowest and highest density of each, (n,) float64, voxels; infinite where it is not known."""


class _Parts(NamedTuple):
    """A box cut into PARTS along each axis, x y z.

    low, high: (3, PARTS) float64, where each part begins and ends, voxels. Parts share their borders.
    """

    low: _Doubles
    high: _Doubles

    def corners(self) -> tuple[_Doubles, _Doubles]:
        """Return low and high corners of all parts: (3, n) float64 each, parts in the order of (y, z, x)."""
        return _spread(*self.low), _spread(*self.high)


def changed(edit: Edit, bricks: Bricks, bounds: Bounds, unfolded: Sequence[Box] = ()) -> list[Box]:
    """Return boxes of lattice points of LOD 0: outside them the edit changes no delta. None where it changes nothing.

    bricks: the deltas that are known. unfolded: boxes outside which they are right: where edits that come before this
        one, and are not in the bricks yet, have changed something.
    """
    unknown = np.empty((len(unfolded) + len(edit.strokes), 2, 3), np.int64)
    unknown[: len(unfolded)] = np.array(unfolded).reshape(-1, 2, 3)
    boxes: list[Box] = []
    for stroke in edit.strokes:
        of, count = brush(stroke), len(unfolded) + len(boxes)
        if of.box.points and (box := _tightened(stroke, of, bricks, bounds, unknown[:count])):
            unknown[count] = box
            boxes.append(box)
    return boxes


def _tightened(stroke: Stroke, of: Brush, bricks: Bricks, bounds: Bounds, unknown: _Ints) -> Box | None:
    """Return the box around what a stroke can change; None if that is nothing."""
    if isinstance(stroke, Delta):
        return _where(stroke.deltas() != 0, of.box, *_points(of.box))
    if not isinstance(stroke, Carve | Fill):
        return of.box if _weighs(stroke) else None
    low = np.array(of.box.low, np.float64)[:, None]
    side = (np.array(of.box.high, np.float64)[:, None] - low) / PARTS
    parts = _Parts(low + side * _FIRST - SLACK, low + side * _LAST + SLACK)
    reach = 0.5 * math.sqrt(float((side * side).sum())) + SLACK
    nearest = distances(of, (*(low + 0.5 * side)[:, 0],), (*side[:, 0],), (PARTS,) * 3) - reach
    flags = _cuts(stroke, of.box, nearest, parts, bricks, bounds, unknown)
    return _where(flags, of.box, np.ceil(parts.low), np.floor(parts.high))


def _weighs(stroke: Stroke) -> bool:
    """Return whether a stroke that is weaker towards its shape's border does anything where it is strongest."""
    if isinstance(stroke, Add):
        return math.floor(stroke.strength * UNITS_PER_VOXEL + 0.5) != 0
    return isinstance(stroke, Smooth | Flatten) and stroke.strength > 0.0


def _cuts(
    stroke: Stroke, box: Box, nearest: _Doubles, parts: _Parts, bricks: Bricks, bounds: Bounds, unknown: _Ints
) -> _Flags:
    """Return in which parts a carve or fill can change a delta."""
    lowest, highest = (found.reshape(nearest.shape) for found in bounds(*parts.corners()))
    deltas_low, deltas_high = _known(bricks, box, parts)
    if isinstance(stroke, Carve):
        flags = (-nearest - np.maximum(lowest, -FIELD_MAX)) * UNITS_PER_VOXEL >= deltas_low
    else:
        flags = (nearest - np.minimum(highest, FIELD_MAX)) * UNITS_PER_VOXEL <= deltas_high
    return np.asarray(flags | _met(parts, unknown, box))


def _known(bricks: Bricks, box: Box, parts: _Parts) -> tuple[_Ints, _Ints]:
    """Return what deltas lie between in each part, so far as bricks know: (y, z, x)."""
    found = [bricks.get(key) for key in keys_in(0, box)]
    if not any(found):
        return (np.zeros((PARTS,) * 3, np.int64),) * 2
    grid = box.cubes(BRICK_BITS).shape
    first, last = np.array(box.low)[:, None], np.array(box.high)[:, None]
    starts = (np.clip(np.floor(parts.low).astype(np.int64), first, last) >> BRICK_BITS) - (first >> BRICK_BITS)
    stops = (np.clip(np.ceil(parts.high).astype(np.int64), first, last) >> BRICK_BITS) - (first >> BRICK_BITS) + 1
    lows = np.array([brick.low if brick else 0 for brick in found]).reshape(grid)
    highs = np.array([brick.high if brick else 0 for brick in found]).reshape(grid)
    for axis, of in ((0, 1), (1, 2), (2, 0)):
        spans = np.stack([starts[of], stops[of]], axis=1).reshape(-1)
        lows = np.minimum.reduceat(_padded(lows, axis), spans, axis).take(range(0, 2 * PARTS, 2), axis)
        highs = np.maximum.reduceat(_padded(highs, axis), spans, axis).take(range(0, 2 * PARTS, 2), axis)
    return lows, highs


def _padded(values: _Ints, axis: int) -> _Ints:
    """Return the values with the last ones once more: `reduceat` takes no end beyond the last."""
    return np.concatenate([values, values.take([-1], axis)], axis)


def _met(parts: _Parts, boxes: _Ints, box: Box) -> _Flags:
    """Return which parts meet any of the boxes that meet `box`: (y, z, x)."""
    near = boxes[((boxes[:, 0] <= box.high) & (boxes[:, 1] >= box.low)).all(axis=1)]
    x, y, z = (
        (near[:, 0, axis, None] <= parts.high[axis]) & (near[:, 1, axis, None] >= parts.low[axis]) for axis in range(3)
    )
    return np.asarray((y[:, :, None, None] & z[:, None, :, None] & x[:, None, None, :]).any(axis=0))


def _spread(x: _Doubles, y: _Doubles, z: _Doubles) -> _Doubles:
    """Return the points of a grid: (3, n), x y z, in the order of (y, z, x)."""
    points = np.empty((3, y.size, z.size, x.size))
    points[0], points[1], points[2] = x[None, None, :], y[:, None, None], z[None, :, None]
    return points.reshape(3, -1)


def _points(box: Box) -> tuple[list[_Doubles], list[_Doubles]]:
    """Return where each point of a box begins and ends, along x, y, z: at itself."""
    places = [np.arange(low, high + 1, dtype=np.float64) for low, high in zip(*box, strict=True)]
    return places, places


def _where(flags: _Flags, box: Box, low: Any, high: Any) -> Box | None:
    """Return the points of a box in all flagged parts and between them; None if there are none.

    flags: (y, z, x). low, high: where each part begins and ends, a sequence along each of x, y, z.
    """
    if not flags.any():
        return None
    along = [np.flatnonzero(flags.any(axis=others)) for others in ((0, 1), (1, 2), (0, 2))]
    x, y, z = (int(ends[at[0]]) for ends, at in zip(low, along, strict=True))
    u, v, w = (int(ends[at[-1]]) for ends, at in zip(high, along, strict=True))
    found = Box((x, y, z), (u, v, w)).shared(box)
    return found if found.points else None
