"""Shapes as numbers: which lattice points a stroke may change, and how far these are from its shape.

Distances are worked out in float64, negative inside. A shape's own place is subtracted before anything else, so they
are as good 2^40 voxels from the origin as at it.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.boxes import Box
from chunkserver.edits.strokes import MARGIN_MIN, Capsule, Carve, Cuboid, Delta, Fill, Sphere, Stroke, unit
from chunkserver.kernel import choose, kernel

SPHERE: Final = 0
CUBOID: Final = 1
CAPSULE: Final = 2
NO_SHAPE: Final = 3
DEPTH: Final = 3
"""Where in a brush's numbers it says how deep the inside is: the radius, or the smallest half extent."""
NUMBERS: Final = 16

_Doubles = NDArray[np.float64]
_Point = tuple[float, ...]


class Brush(NamedTuple):
    """A stroke's shape, and what the stroke may change.

    kind: SPHERE, CUBOID, CAPSULE, or NO_SHAPE for a delta.
    numbers: (NUMBERS,) float64: the shape's place (its centre, or a) x y z; its depth; then of a box the half extents
        and the rows of the matrix that turns it back, of a capsule b - a and 1 / |b - a|^2, or 0 if a is b.
    box: the lattice points of LOD 0 that the stroke may change; there may be none.
    """

    kind: int
    numbers: _Doubles
    box: Box


def brush(stroke: Stroke) -> Brush:
    """Return a stroke's shape as numbers, and its box: the points in the axis-aligned box around the shape.

    For carve and fill that box is grown by `max(MARGIN_MIN, depth)` voxels on each side, so that densities around what
    was cut are distances from it.
    """
    match stroke:
        case Sphere(center=center, radius=radius):
            return _brush(stroke, SPHERE, (*center, radius), center, center, (radius,) * 3)
        case Capsule(a=a, b=b, radius=radius):
            along = tuple(end - start for start, end in zip(a, b, strict=True))
            square = math.fsum(part * part for part in along)
            return _brush(stroke, CAPSULE, (*a, radius, *along, 1 / square if square else 0.0), a, b, (radius,) * 3)
        case Cuboid(center=center, half_extents=half, rotation=rotation):
            rows = _turning_back(rotation)
            reach = tuple(abs(u) * half[0] + abs(v) * half[1] + abs(w) * half[2] for u, v, w in zip(*rows, strict=True))
            numbers = (*center, min(half), *half, *rows[0], *rows[1], *rows[2])
            return _brush(stroke, CUBOID, numbers, center, center, reach)
        case Delta(min=low, size=size):
            x, y, z = (first + count - 1 for first, count in zip(low, size, strict=True))
            return Brush(NO_SHAPE, np.zeros(NUMBERS), Box(low, (x, y, z)))
    raise TypeError(f"{stroke!r} has no shape")


def _brush(stroke: Stroke, kind: int, numbers: _Point, first: _Point, last: _Point, reach: _Point) -> Brush:
    """Return the brush of a shape that reaches so far around the box of two points."""
    margin = max(MARGIN_MIN, numbers[DEPTH]) if isinstance(stroke, Carve | Fill) else 0.0
    (a, b, c), (d, e, f), (u, v, w) = first, last, reach
    low = math.ceil(min(a, d) - u - margin), math.ceil(min(b, e) - v - margin), math.ceil(min(c, f) - w - margin)
    high = math.floor(max(a, d) + u + margin), math.floor(max(b, e) + v + margin), math.floor(max(c, f) + w + margin)
    return Brush(kind, np.array(numbers + (0.0,) * (NUMBERS - len(numbers))), Box(low, high))


def _turning_back(quaternion: _Point) -> tuple[_Point, _Point, _Point]:
    """Return the rows of the matrix that turns back what the quaternion x, y, z, w turns: the axes of the box."""
    x, y, z, w = unit(quaternion)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )


def distances(of: Brush, low: _Point, step: _Point, shape: tuple[int, int, int]) -> _Doubles:
    """Return how far points of a grid are from a shape, voxels, negative inside: Euclidean, exact but for rounding.

    low: x, y, z of the first point. step: from one to the next along x, y, z. shape: how many along (y, z, x).

    Returns (y, z, x) float64. The grid has a point.
    """
    rows, depth, width = shape
    x, y, z = (
        first + np.arange(count) * by - place
        for first, count, by, place in zip(low, (width, rows, depth), step, of.numbers[:3], strict=True)
    )
    out = np.empty(shape)
    _write_distances(of.kind, of.numbers, x, y, z, out.reshape(-1))
    return out


@kernel
def _write_distances(kind: int, p: _Doubles, x: _Doubles, y: _Doubles, z: _Doubles, out: _Doubles) -> None:
    """Write the distances of points (y, z, x), which are given from the shape's place."""
    n, at = np.uint64(x.size), np.uint64(0)
    p3, p4, p5, p6, p7, p8, p9 = p[3], p[4], p[5], p[6], p[7], p[8], p[9]
    p10, p11, p12, p13, p14, p15 = p[10], p[11], p[12], p[13], p[14], p[15]
    for j in range(y.size):
        for k in range(z.size):
            yj, zk = y[j], z[k]
            if kind == SPHERE:
                for i in range(n):
                    out[at + i] = np.sqrt(x[i] * x[i] + yj * yj + zk * zk) - p3
            elif kind == CUBOID:
                for i in range(n):
                    a = abs(x[i] * p7 + yj * p8 + zk * p9) - p4
                    b = abs(x[i] * p10 + yj * p11 + zk * p12) - p5
                    c = abs(x[i] * p13 + yj * p14 + zk * p15) - p6
                    inside = choose(a > b, a, b)
                    inside = choose(inside > c, inside, c)
                    a, b, c = choose(a > 0.0, a, 0.0), choose(b > 0.0, b, 0.0), choose(c > 0.0, c, 0.0)
                    out[at + i] = np.sqrt(a * a + b * b + c * c) + choose(inside < 0.0, inside, 0.0)
            else:
                for i in range(n):
                    t = (x[i] * p4 + yj * p5 + zk * p6) * p7
                    t = choose(t > 0.0, t, 0.0)
                    t = choose(t < 1.0, t, 1.0)
                    a, b, c = x[i] - t * p4, yj - t * p5, zk - t * p6
                    out[at + i] = np.sqrt(a * a + b * b + c * c) - p3
            at += n
