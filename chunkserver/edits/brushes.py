"""Strokes as numbers, for kernels: which lattice points they may change, and how far these are from their shapes.

Distances are worked out in float64, negative inside. A shape's own place is subtracted before anything else, so they
are as good 2^40 voxels from the origin as at it.
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.strokes import MARGIN_MIN, Stroke, unit
from chunkserver.kernel import choose, kernel

CARVE: Final = 0
FILL: Final = 1
ADD: Final = 2
SMOOTH: Final = 3
FLATTEN: Final = 4
DELTA: Final = 5
SPHERE: Final = 0
CUBOID: Final = 1
CAPSULE: Final = 2
NO_SHAPE: Final = 3

DEPTH: Final = 3
"""Where in a stroke's numbers it says how deep the inside is: the radius, or the smallest half extent."""
STRENGTH: Final = 16
POINT: Final = 17
NORMAL: Final = 20
NUMBERS: Final = 23

_OPS: Final = {"carve": CARVE, "fill": FILL, "add": ADD, "smooth": SMOOTH, "flatten": FLATTEN, "delta": DELTA}
_PLACE: Final = (0.0, 0.0, 0.0)

_Doubles = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Point = tuple[float, ...]


class Brushes(NamedTuple):
    """Strokes, one after the other.

    ops, shapes: (n,) int64: CARVE to DELTA, SPHERE to NO_SHAPE.
    numbers: (n, NUMBERS) float64: the shape's place (its centre, or a) x y z; its depth; then of a box the half extents
        and the rows of the matrix that turns it back, of a capsule b - a and 1 / |b - a|^2, or 0 if a is b; at STRENGTH
        and behind it the op's strength, point and normal, of length 1.
    boxes: (n, 2, 3) int64: first and last lattice point x, y, z of LOD 0 that each may change; there may be none.
    """

    ops: _Ints
    shapes: _Ints
    numbers: _Doubles
    boxes: _Ints

    def points(self) -> _Doubles:
        """Return how many lattice points each may change: (n,) float64, exact below 2^53."""
        return np.asarray((self.boxes[:, 1] - self.boxes[:, 0] + 1.0).prod(axis=1))

    def with_points(self) -> _Ints:
        """Return the boxes in which there is a point: (n, 2, 3) int64."""
        return self.boxes[self.points() > 0]

    def alone(self) -> NDArray[np.bool_]:
        """Return which strokes are worked out alone: (n,) bool. There is no kernel for them."""
        return np.asarray(self.ops >= SMOOTH)

    def part(self, which: _Ints) -> "Brushes":
        """Return some of them."""
        return Brushes(self.ops[which], self.shapes[which], self.numbers[which], self.boxes[which])

    @classmethod
    def joined(cls, parts: Sequence["Brushes"]) -> "Brushes":
        """Return all of them, in their order."""
        return parts[0] if len(parts) == 1 else cls(*map(np.concatenate, zip(*parts, strict=True)))

    @classmethod
    def of(cls, strokes: Sequence[Stroke]) -> "Brushes":
        """Return strokes as numbers, and their boxes: the points in the axis-aligned box around the shape.

        For carve and fill that box is grown by `max(MARGIN_MIN, depth)` voxels on each side, so that densities around
        what was cut are distances from it.
        """
        rows = [_row(stroke) for stroke in strokes]
        found = np.array([numbers for _, _, numbers in rows])
        ops, shapes = np.array([row[:2] for row in rows], np.int64).T
        first, last, reach = found[:, :3], found[:, NUMBERS : NUMBERS + 3], found[:, NUMBERS + 3 :]
        margin = np.where(ops <= FILL, np.maximum(found[:, DEPTH], MARGIN_MIN), 0.0)[:, None]
        boxes = np.empty((len(rows), 2, 3), np.int64)
        boxes[:, 0] = np.ceil(np.minimum(first, last) - reach - margin)
        boxes[:, 1] = np.floor(np.maximum(first, last) + reach + margin)
        return cls(ops, shapes, np.ascontiguousarray(found[:, :NUMBERS]), boxes)


def _row(stroke: Any) -> tuple[int, int, _Point]:
    """Return a stroke's op and shape; its numbers, the other end of its place, and how far it reaches around both."""
    if stroke.op == "delta":
        last = tuple(float(at + count - 1) for at, count in zip(stroke.min, stroke.size, strict=True))
        return DELTA, NO_SHAPE, (*map(float, stroke.min), *(0.0,) * (NUMBERS - 3), *last, *_PLACE)
    op = _OPS[stroke.op]
    strength = stroke.strength if op > FILL else 0.0
    how = (strength, *stroke.point, *unit(stroke.normal)) if op == FLATTEN else (strength, *_PLACE, *_PLACE)
    if stroke.shape == "sphere":
        center, r = stroke.center, stroke.radius
        return op, SPHERE, (*center, r, *_PLACE, *_PLACE, *_PLACE, *_PLACE, *how, *center, r, r, r)
    if stroke.shape == "capsule":
        (a, b, c), (d, e, f), r = stroke.a, stroke.b, stroke.radius
        along = d - a, e - b, f - c
        square = math.fsum(part * part for part in along)
        shaped = (*along, 1 / square if square else 0.0)
        return op, CAPSULE, (a, b, c, r, *shaped, *_PLACE, *_PLACE, 0.0, 0.0, *how, d, e, f, r, r, r)
    center, half = stroke.center, stroke.half_extents
    rows = _turning_back(stroke.rotation)
    reach = (abs(u) * half[0] + abs(v) * half[1] + abs(w) * half[2] for u, v, w in zip(*rows, strict=True))
    return op, CUBOID, (*center, min(half), *half, *rows[0], *rows[1], *rows[2], *how, *center, *reach)


def _turning_back(quaternion: _Point) -> tuple[_Point, _Point, _Point]:
    """Return the rows of the matrix that turns back what the quaternion x, y, z, w turns: the axes of the box."""
    x, y, z, w = unit(quaternion)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )


@kernel
def write_distances(shape: int, p: _Doubles, along: _Doubles, box: _Ints, out: _Doubles) -> None:
    """Write how far points of a grid are from a shape, voxels, negative inside: Euclidean, exact but for rounding.

    p: (NUMBERS,), a stroke's numbers. along: (3, n) their coordinates x, y, z, from the shape's place. box: (2, 3)
    int64, the first and last of them along each axis: as many points are there. out: (y * z * x,), in that order.
    """
    n, at = np.uint64(box[1, 0] - box[0, 0] + 1), np.uint64(0)
    p3, p4, p5, p6, p7, p8, p9 = p[3], p[4], p[5], p[6], p[7], p[8], p[9]
    p10, p11, p12, p13, p14, p15 = p[10], p[11], p[12], p[13], p[14], p[15]
    for j in range(box[1, 1] - box[0, 1] + 1):
        for k in range(box[1, 2] - box[0, 2] + 1):
            y, z = along[1, j], along[2, k]
            if shape == CUBOID:
                for i in range(n):
                    a = abs(along[0, i] * p7 + y * p8 + z * p9) - p4
                    b = abs(along[0, i] * p10 + y * p11 + z * p12) - p5
                    c = abs(along[0, i] * p13 + y * p14 + z * p15) - p6
                    inside = choose(a > b, a, b)
                    inside = choose(inside > c, inside, c)
                    a, b, c = choose(a > 0.0, a, 0.0), choose(b > 0.0, b, 0.0), choose(c > 0.0, c, 0.0)
                    out[at + i] = np.sqrt(a * a + b * b + c * c) + choose(inside < 0.0, inside, 0.0)
            else:  # of a sphere b is a
                for i in range(n):
                    t = (along[0, i] * p4 + y * p5 + z * p6) * p7
                    t = choose(t > 0.0, t, 0.0)
                    t = choose(t < 1.0, t, 1.0)
                    a, b, c = along[0, i] - t * p4, y - t * p5, z - t * p6
                    out[at + i] = np.sqrt(a * a + b * b + c * c) - p3
            at += n
