"""Bounds of densities made of densities: what an instruction of `arithmetic` makes of the bounds of what it reads.

Each takes the least, the greatest and the spread of its operands, and returns those of its value; what they are, and
why they hold, stands in `intervals`.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.arithmetic import ZERO, linear, piece, smooth_min
from chunkserver.kernel import inlined

SLACK: Final = 2.0**-20
"""Of the magnitudes that go in: 16 roundings of float32."""
LEAST_SLACK: Final = 2.0**-145
"""16 roundings of float32 between the least numbers that it has, which lie as far apart as they are large."""
INFINITE: Final = np.float32(np.inf)
STEEPEST_STEP: Final = 1.5
"""The slope of 3t^2 - 2t^3 half-way, where it is largest."""

_Doubles = NDArray[np.float64]


@inlined
def largest(low: np.float32, high: np.float32) -> float:
    """Return the largest magnitude between two bounds."""
    return np.float64(max(abs(low), abs(high)))


@inlined
def combine_bounds(
    op: int,
    a0: np.float32,
    a1: np.float32,
    da: float,
    b0: np.float32,
    b1: np.float32,
    db: float,
    c0: np.float32,
    c1: np.float32,
    dc: float,
    x0: float,
    x1: float,
    dx: float,
    n0: float,
    n1: float,
    n2: float,
) -> tuple[np.float32, np.float32, float]:
    """Return the bounds of what `op` makes of values a, b, c and coordinate x, but for REMAP: low, high, spread."""
    if op == ops.CONSTANT:
        return np.float32(n0), np.float32(n0), 0.0
    if op == ops.COORDINATE:
        return np.float32(x0), np.float32(x1), dx
    if op == ops.HEIGHT:
        return np.float32(x0 - np.float64(a1)), np.float32(x1 - np.float64(a0)), dx + da
    if op == ops.ABOVE:
        return np.float32(np.float32(x0) - a1), np.float32(np.float32(x1) - a0), dx + da + SLACK * max(-x0, x1)
    if op == ops.LINEAR:
        return _linear(a0, a1, da, n0, n1, n2)
    if op == ops.ADD:
        return np.float32(a0 + b0), np.float32(a1 + b1), da + db
    if op == ops.SUBTRACT:
        return np.float32(a0 - b1), np.float32(a1 - b0), da + db
    if op == ops.MULTIPLY:
        p, q, r, s = np.float32(a0 * b0), np.float32(a0 * b1), np.float32(a1 * b0), np.float32(a1 * b1)
        return min(p, q, r, s), max(p, q, r, s), largest(a0, a1) * db + largest(b0, b1) * da
    if op == ops.MIN:
        return min(a0, b0), min(a1, b1), max(da, db)
    if op == ops.MAX:
        return max(a0, b0), max(a1, b1), max(da, db)
    if op in (ops.ABS, ops.FOLD):
        return _fold(op, a0, a1, da, b0, b1, db, n0, n1)
    if op == ops.SELECT:
        return _select(a0, a1, da, b0, b1, db, c0, c1, dc, n0, n1, n2)
    return _smooth(op, a0, a1, da, b0, b1, db, n0, n1)


@inlined
def _linear(
    a0: np.float32, a1: np.float32, da: float, n0: float, n1: float, n2: float
) -> tuple[np.float32, np.float32, float]:
    first, factor, last = np.float32(n0), np.float32(n1), np.float32(n2)
    p, q = linear(a0, first, factor, last), linear(a1, first, factor, last)
    steep = np.float64(abs(factor))
    inner = max(abs(np.float64(a0) + n0), abs(np.float64(a1) + n0)) * steep
    return min(p, q), max(p, q), steep * da + SLACK * inner


@inlined
def _fold(
    op: int,
    a0: np.float32,
    a1: np.float32,
    da: float,
    b0: np.float32,
    b1: np.float32,
    db: float,
    n0: float,
    n1: float,
) -> tuple[np.float32, np.float32, float]:
    inner = ZERO if a0 <= ZERO <= a1 else min(abs(a0), abs(a1))
    outer = max(abs(a0), abs(a1))
    if op == ops.ABS:
        return inner, outer, da
    base, slope = np.float32(n0), np.float32(n1)
    p, q = np.float32(base + np.float32(slope * inner)), np.float32(base + np.float32(slope * outer))
    by = db + abs(np.float64(slope)) * da + SLACK * (abs(base) + abs(slope) * outer)
    return np.float32(b0 + min(p, q)), np.float32(b1 + max(p, q)), by


@inlined
def _select(
    by0: np.float32,
    by1: np.float32,
    d_by: float,
    below0: np.float32,
    below1: np.float32,
    d_below: float,
    above0: np.float32,
    above1: np.float32,
    d_above: float,
    n0: float,
    n1: float,
    slope: float,
) -> tuple[np.float32, np.float32, float]:
    first, last = np.float32(n0), np.float32(n1)
    if by1 <= first and by1 < last:
        return below0, below1, d_below
    if by0 >= last:
        return above0, above1, d_above
    low, high = min(below0, above0), max(below1, above1)
    slack = SLACK * largest(low, high)
    apart = np.float64(max(above1 - below0, below1 - above0))
    step = STEEPEST_STEP * (slope * d_by + SLACK * (1.0 + slope * largest(by0, by1))) if slope > 0.0 else 1.0
    moved = max(d_below, d_above) + apart * min(step, 1.0)
    return np.float32(low - slack), np.float32(high + slack), moved + 4.0 * slack


@inlined
def _smooth(
    op: int,
    a0: np.float32,
    a1: np.float32,
    da: float,
    b0: np.float32,
    b1: np.float32,
    db: float,
    n0: float,
    n1: float,
) -> tuple[np.float32, np.float32, float]:
    """Bound the smooth minimum and maximum, which rise with a and with b, together by no more than the faster one."""
    radius, scale = np.float32(n0), np.float32(n1)
    sign = np.float32(1) if op == ops.SMOOTH_MIN else np.float32(-1)
    first = np.float32(sign * smooth_min(np.float32(sign * a0), np.float32(sign * b0), radius, scale))
    last = np.float32(sign * smooth_min(np.float32(sign * a1), np.float32(sign * b1), radius, scale))
    slack = SLACK * (max(largest(a0, a1), largest(b0, b1)) + n0)
    return np.float32(first - slack), np.float32(last + slack), max(da, db) + 2.0 * slack


@inlined
def remap_bounds(
    a0: np.float32, a1: np.float32, da: float, numbers: _Doubles, n: int
) -> tuple[np.float32, np.float32, float]:
    """Bound a piecewise linear curve: it is lowest and highest at the ends, or at knots between them."""
    first = last = np.float32(numbers[n + 2])
    low, high, highest, steepest = INFINITE, -INFINITE, ZERO, 0.0
    for knot in range(np.int64(numbers[n])):
        at = n + 1 + ops.KNOT_NUMBERS * knot
        start, to = np.float32(numbers[at]), np.float32(numbers[at + 1])
        rise, scale = np.float32(numbers[at + 2]), np.float32(numbers[at + 3])
        if knot + 1 < numbers[n]:
            first, last = piece(first, a0, start, rise, scale), piece(last, a1, start, rise, scale)
            steepest = max(steepest, abs(numbers[at + 2] * numbers[at + 3]))
        highest = max(highest, abs(to))
        if a0 <= start <= a1:
            low, high = min(low, to), max(high, to)
    slack = SLACK * numbers[n] * np.float64(highest)
    rounding = steepest * SLACK * largest(a0, a1)
    low, high = min(low, first, last), max(high, first, last)
    return np.float32(low - slack), np.float32(high + slack), steepest * da + 2.0 * slack + rounding
