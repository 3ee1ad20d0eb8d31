"""Where an edit can change anything: known before it is folded, from bounds of the field and of the deltas so far.

The box of a carve or fill is cut into parts. What is nearest to the shape in a part, and what the field and the deltas
lie between there, may show that the stroke changes nothing in it. Errs on the large side only.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS
from chunkserver.edits.bricks import Bricks
from chunkserver.edits.brushes import ADD, CARVE, DELTA, FILL, STRENGTH, Brushes, write_distances
from chunkserver.edits.cubes import met
from chunkserver.edits.edit import Edit
from chunkserver.edits.strokes import FIELD_MAX, UNITS_PER_VOXEL, Delta
from chunkserver.kernel import inlined, kernel

SIDE: Final = 4
"""A stroke's box is looked at in so many parts along each axis."""
PARTS: Final = SIDE**3
SLACK: Final = 2.0**-10
"""Voxels: more than what the rounding of a distance or of a part's border comes to, 2^41 voxels across."""

_LIMIT: Final = float(FIELD_MAX)
_NONE: Final = np.empty((0, 2, 3), np.int64)
_NOWHERE: Final = np.array([[1], [0]])
_ALL: Final = np.array([[0, 0, 0], [SIDE - 1, SIDE - 1, SIDE - 1]])
"""The parts of a box: the first and the last one."""

_Doubles = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Numbers = NDArray[np.int32]
_Flags = NDArray[np.bool_]

Bounds = Callable[[_Doubles, _Doubles], tuple[_Doubles, _Doubles]]
"""What the field of LOD 0 lies between before any edit. Takes low and high corners of n boxes, (3, n) float64, x y z,
voxels; returns lowest and highest density of each, (n,) float64, voxels; infinite where it is not known."""


def narrowed(edit: Edit, bricks: Bricks, bounds: Bounds, unfolded: _Ints = _NONE) -> Edit:
    """Return the edit with smaller boxes of lattice points: outside them no stroke changes a delta.

    A box has no point where its stroke changes nothing. To work out the strokes in these boxes alone makes the same
    deltas as in those of `Brushes.of`.

    bricks: the deltas that are known. unfolded: boxes outside which they are right: (n, 2, 3) int64, first and last
        point x, y, z of each; those that this has found for the edits that come before this one and are not in the
        bricks yet.
    """
    of = edit.brushes
    does = (of.points() > 0) & _weighs(of)
    cuts = np.flatnonzero(does & (of.ops <= FILL))
    known = np.concatenate([unfolded, of.boxes]) if len(cuts) else of.boxes.copy()
    boxes = known[len(known) - len(of.boxes) :]
    boxes[~does] = _NOWHERE
    for n in np.flatnonzero(of.ops == DELTA).tolist():
        stroke = edit.strokes[n]
        assert isinstance(stroke, Delta)
        _tighten_values(stroke.deltas(), boxes[n])
    if len(cuts):
        _tighten_cuts(cuts, of, known, bricks, bounds)
    return edit.within(boxes)


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
    cut = of.part(cuts)
    corners, nearest = np.empty((2, 3, len(cuts) * PARTS)), np.empty(len(cuts) * PARTS)
    _write_parts(cut.shapes, cut.numbers, cut.boxes, _ALL, np.empty((3, SIDE)), corners, nearest)
    lowest, highest = np.clip(bounds(corners[0], corners[1]), -_LIMIT, _LIMIT)  # as the field is
    cubes = met(np.zeros(len(cuts), np.int64), cut.boxes, BRICK_BITS)
    known = [(brick.low, brick.high) if brick else (0, 0) for brick in map(bricks.get, cubes.places())]
    which, near = len(boxes) - len(of.ops) + cuts, np.empty(len(boxes), np.int64)
    _tighten(cut.ops, corners, nearest, lowest, highest, np.array(known), cubes.grids, cubes.starts, which, near, boxes)


@kernel
def _write_parts(
    shapes: _Ints,
    numbers: _Doubles,
    boxes: _Ints,
    places: _Ints,
    along: _Doubles,
    corners: _Doubles,
    nearest: _Doubles,
) -> None:
    """Write low and high corners of all parts, and how near to them the shape is at least; in the order (y, z, x).

    places: the first and the last part. along: (3, SIDE) scratch.
    """
    for n in range(shapes.size):
        across = 0.0
        for axis in range(3):
            first = np.float64(boxes[n, 0, axis])
            side = (np.float64(boxes[n, 1, axis]) - first) / SIDE
            across += side * side
            period = SIDE if axis == 2 else SIDE * SIDE if axis == 1 else 1
            for i in range(SIDE):
                along[axis, i] = first - numbers[n, axis] + side * (i + 0.5)
            for i in range(PARTS):
                begin = first + side * (i // period % SIDE)
                corners[0, axis, n * PARTS + i] = begin - SLACK
                corners[1, axis, n * PARTS + i] = begin + side + SLACK
        found = nearest[n * PARTS : (n + 1) * PARTS]
        write_distances(shapes[n], numbers[n], along, places, found)
        found -= 0.5 * np.sqrt(across) + SLACK


@kernel
def _tighten(
    ops: _Ints,
    corners: _Doubles,
    nearest: _Doubles,
    lowest: _Doubles,
    highest: _Doubles,
    known: _Ints,
    grids: _Numbers,
    starts: _Ints,
    which: _Ints,
    near: _Ints,
    boxes: _Ints,
) -> None:
    """known: (bricks, 2), lowest and highest delta of each. grids, starts: as `Cubes` has them; which: of the boxes.

    near: (boxes,) scratch.
    """
    part, all_parts = np.empty((2, 2, 3), np.int64)
    for n in range(ops.size):
        box = boxes[which[n]]
        count = 0
        for other in range(which[n]):
            if _meet(boxes[other], box):
                near[count] = other
                count += 1
        all_parts[0], all_parts[1], does = box[1], box[0], False
        for i in range(n * PARTS, (n + 1) * PARTS):
            for axis in range(3):
                part[0, axis] = max(box[0, axis], np.int64(-np.floor(-corners[0, axis, i])))
                part[1, axis] = min(box[1, axis], np.int64(np.floor(corners[1, axis, i])))
            if part[0, 0] > part[1, 0] or part[0, 1] > part[1, 1] or part[0, 2] > part[1, 2]:
                continue
            least, most = _between(known, grids[starts[n] :], box, part)
            if ops[n] == CARVE:
                changes = (-nearest[i] - lowest[i]) * UNITS_PER_VOXEL >= least
            else:
                changes = (nearest[i] - highest[i]) * UNITS_PER_VOXEL <= most
            for other in range(count):
                if changes:
                    break
                changes = _meet(boxes[near[other]], part)
            if changes:
                does = True
                for axis in range(3):
                    all_parts[0, axis] = min(all_parts[0, axis], part[0, axis])
                    all_parts[1, axis] = max(all_parts[1, axis], part[1, axis])
        if does:
            box[:] = all_parts
        else:
            box[0], box[1] = 1, 0


@inlined
def _meet(one: _Ints, other: _Ints) -> bool:
    """Return whether there is a point in both; there is one in the other."""
    meet = True
    for axis in range(3):
        low, high = one[0, axis], one[1, axis]
        meet &= low <= high and low <= other[1, axis] and high >= other[0, axis]
    return meet


@inlined
def _between(known: _Ints, grid: _Numbers, box: _Ints, part: _Ints) -> tuple[np.int64, np.int64]:
    """Return what deltas lie between in a part of a box. grid: the numbers of the bricks that the box meets."""
    x, y, z = box[0, 0] >> BRICK_BITS, box[0, 1] >> BRICK_BITS, box[0, 2] >> BRICK_BITS
    along, across = (box[1, 0] >> BRICK_BITS) - x + 1, (box[1, 2] >> BRICK_BITS) - z + 1
    least, most, is_first = np.int64(0), np.int64(0), True
    for b in range((part[0, 1] >> BRICK_BITS) - y, (part[1, 1] >> BRICK_BITS) - y + 1):
        for c in range((part[0, 2] >> BRICK_BITS) - z, (part[1, 2] >> BRICK_BITS) - z + 1):
            for a in range((part[0, 0] >> BRICK_BITS) - x, (part[1, 0] >> BRICK_BITS) - x + 1):
                brick = grid[(b * across + c) * along + a]
                least = known[brick, 0] if is_first else min(least, known[brick, 0])
                most = known[brick, 1] if is_first else max(most, known[brick, 1])
                is_first = False
    return least, most
