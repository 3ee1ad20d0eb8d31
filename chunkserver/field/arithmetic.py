"""Densities made of densities: loops over value registers, one step rounded to float32 at a time."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.kernel import inlined, kernel, spliced

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]

ZERO = np.float32(0)
ONE = np.float32(1)


@kernel
def combine(
    code: NDArray[np.int32], at: int, n: int, in_planes: bool, numbers: _Doubles, places: _Doubles, values: _Floats
) -> None:
    """Run instruction `at` of a tape, one that makes a value of values, for the first n points.

    in_planes: whether all of them have the y of the first. places: (coordinate registers, slab), values: (value
    registers, slab). They are handed on whole: a view of each register takes longer than a pass over some rows.
    """
    op, count, number = code[at, ops.CODE], np.uint64(n), code[at, ops.NUMBERS]
    out, a, b = np.uint64(code[at, ops.OUT]), np.uint64(code[at, ops.A]), np.uint64(code[at, ops.B])
    n0, n1, n2 = np.float32(numbers[number]), np.float32(numbers[number + 1]), np.float32(numbers[number + 2])
    if op <= ops.ABOVE:
        x = np.uint64(code[at, ops.X])
        if in_planes and x == ops.LEVEL:
            _of_level(op, places[x, 0], a, out, count, values)
        else:
            _of_coordinate(op, a, x, out, count, places, values)
    elif op <= ops.MAX:
        _two(op, a, b, out, count, values)
    elif op == ops.REMAP:
        _remap(a, out, count, numbers[number:], values)
    else:
        _shaped(op, a, b, np.uint64(code[at, ops.C]), out, count, n0, n1, n2, values)


@spliced
def _of_coordinate(
    op: int, a: np.uint64, x: np.uint64, out: np.uint64, count: np.uint64, places: _Doubles, values: _Floats
) -> None:
    if op == ops.COORDINATE:
        for i in range(count):
            values[out, i] = np.float32(places[x, i])
    elif op == ops.HEIGHT:
        for i in range(count):
            values[out, i] = np.float32(places[x, i] - np.float64(values[a, i]))
    else:
        for i in range(count):
            values[out, i] = np.float32(places[x, i]) - values[a, i]


@spliced
def _of_level(op: int, y: float, a: np.uint64, out: np.uint64, count: np.uint64, values: _Floats) -> None:
    """Write what `_of_coordinate` would, where the coordinate is y at every point."""
    level = np.float32(y)
    if op == ops.COORDINATE:
        for i in range(count):
            values[out, i] = level
    elif op == ops.HEIGHT:
        for i in range(count):
            values[out, i] = np.float32(y - np.float64(values[a, i]))
    else:
        for i in range(count):
            values[out, i] = level - values[a, i]


@spliced
def _two(op: int, a: np.uint64, b: np.uint64, out: np.uint64, count: np.uint64, values: _Floats) -> None:
    if op == ops.ADD:
        for i in range(count):
            values[out, i] = values[a, i] + values[b, i]
    elif op == ops.SUBTRACT:
        for i in range(count):
            values[out, i] = values[a, i] - values[b, i]
    elif op == ops.MULTIPLY:
        for i in range(count):
            values[out, i] = values[a, i] * values[b, i]
    elif op == ops.MIN:
        for i in range(count):
            values[out, i] = values[a, i] if values[a, i] < values[b, i] else values[b, i]
    else:
        for i in range(count):
            values[out, i] = values[a, i] if values[a, i] > values[b, i] else values[b, i]


@spliced
def _shaped(
    op: int,
    a: np.uint64,
    b: np.uint64,
    c: np.uint64,
    out: np.uint64,
    count: np.uint64,
    n0: np.float32,
    n1: np.float32,
    n2: np.float32,
    values: _Floats,
) -> None:
    if op == ops.CONSTANT:
        for i in range(count):
            values[out, i] = n0
    elif op == ops.LINEAR:
        for i in range(count):
            values[out, i] = linear(values[a, i], n0, n1, n2)
    elif op == ops.ABS:
        for i in range(count):
            values[out, i] = abs(values[a, i])
    elif op == ops.FOLD:
        for i in range(count):
            values[out, i] = fold(values[a, i], values[b, i], n0, n1)
    elif op == ops.SMOOTH_MIN:
        for i in range(count):
            values[out, i] = smooth_min(values[a, i], values[b, i], n0, n1)
    elif op == ops.SMOOTH_MAX:
        for i in range(count):
            values[out, i] = -smooth_min(-values[a, i], -values[b, i], n0, n1)
    else:
        for i in range(count):
            values[out, i] = select(values[a, i], values[b, i], values[c, i], n0, n1, n2)


@inlined
def linear(a: np.float32, first: np.float32, factor: np.float32, last: np.float32) -> np.float32:
    """Return ((a + first) * factor) + last."""
    return np.float32(np.float32(np.float32(a + first) * factor) + last)


@inlined
def fold(a: np.float32, b: np.float32, base: np.float32, slope: np.float32) -> np.float32:
    """Return b + (base + slope * |a|): one octave of a ridged or billow sum."""
    return np.float32(b + np.float32(base + np.float32(slope * abs(a))))


@inlined
def smooth_min(a: np.float32, b: np.float32, radius: np.float32, scale: np.float32) -> np.float32:
    """Return the minimum, less h^2 * scale with h = max(radius - |a - b|, 0) and scale = 1 / (4 radius)."""
    less = a if a < b else b
    near = np.float32(radius - abs(np.float32(a - b)))
    near = near if near > ZERO else ZERO
    return np.float32(less - np.float32(np.float32(near * near) * scale))


@inlined
def select(
    by: np.float32, below: np.float32, above: np.float32, first: np.float32, last: np.float32, slope: np.float32
) -> np.float32:
    """Return `below` up to by = first, `above` from by = last on, and a smooth step in between."""
    t = _share(np.float32(np.float32(by - first) * slope))
    t = np.float32(np.float32(t * t) * np.float32(np.float32(3) - np.float32(t + t)))
    blend = np.float32(below + np.float32(t * np.float32(above - below)))
    return blend if by < last else above


@inlined
def _share(t: np.float32) -> np.float32:
    """Return t held between 0 and 1."""
    t = t if t > ZERO else ZERO
    return t if t < ONE else ONE


@spliced
def _remap(a: np.uint64, out: np.uint64, count: np.uint64, numbers: _Doubles, values: _Floats) -> None:
    """Write the first knot's value, plus each piece's rise by how far along it the argument is."""
    first = np.float32(numbers[2])
    for i in range(count):
        values[out, i] = first
    for knot in range(np.int64(numbers[0]) - 1):
        at = 1 + ops.KNOT_NUMBERS * knot
        start, rise, scale = np.float32(numbers[at]), np.float32(numbers[at + 2]), np.float32(numbers[at + 3])
        for i in range(count):
            values[out, i] = piece(values[out, i], values[a, i], start, rise, scale)


@inlined
def piece(below: np.float32, a: np.float32, start: np.float32, rise: np.float32, scale: np.float32) -> np.float32:
    """Return `below` plus as much of `rise` as lies between start and a, where scale = 1 / (stop - start)."""
    t = _share(np.float32(np.float32(a - start) * scale))
    return np.float32(below + np.float32(rise * t))
