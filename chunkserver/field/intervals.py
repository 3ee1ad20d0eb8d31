"""The same tape over a box instead of a point: bounds that hold for every sample in it.

Bounds are kept in the types of the registers and worked out with the interpreter's own operations. One such operation,
rounded to nearest, never decreases where its exact result increases, so bounds of it are exact bounds of what is
computed: nothing has to be rounded outwards. Where a step is more than one operation, or is bounded by how steep it is,
the bounds are widened by more than its rounding (SLACK, NOISE_SLACK, DISTANCE_SLACK).

What is bounded by how steep it is starts from its value at the middle of the box, where the interpreter has worked out
every register. Noise lies within its range, and within its Lipschitz constant times the distance from there: tight
wherever the box is smaller than a feature. A distance changes by at most as much as the point moves.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.arithmetic import ZERO, piece, smooth_min
from chunkserver.field.coordinates import cell
from chunkserver.field.interpreter import run
from chunkserver.field.noise.lattice import COORDINATE_MAX, scratch
from chunkserver.field.tape import Tape
from chunkserver.kernel import inlined, kernel

SLACK: Final = 2.0**-20
"""Of the magnitudes that go in: 16 roundings of float32."""
NOISE_SLACK: Final = 2.0**-16
"""Of noise in [-1, 1]: what its roundings in float32 may add up to (`tests/property/test_intervals.py`)."""
DISTANCE_SLACK: Final = 2.0**-40
"""Of the coordinates and of the shape's own numbers: thousands of roundings of float64."""
LATTICE_SLACK: Final = 2.0**-50
"""Of a coordinate in lattice cells: eight roundings of float64, at two points and on three axes."""
FINITE_MAX: Final = 1e38
"""Values are refused from here on: a third of what float32 holds."""
ALL_FINITE: Final = -1
ANYWHERE: Final = math.inf
"""Distance from the middle at which noise is bounded by its range alone."""
INFINITE: Final = np.float32(np.inf)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Code = NDArray[np.int32]


def bounds(tape: Tape, box: _Doubles, any_seed: bool = False) -> tuple[int, _Floats]:
    """Bound every register of a tape over a box.

    tape: one that keeps every step in a register of its own (`tape.keep_all`).
    box: (3, 2) float64, low and high of x, y, z, voxels.
    any_seed: bound noise by its range alone, so that the bounds hold for, and are the same for, every seed.

    Returns ALL_FINITE or the first instruction that is not finite (then nothing after it is bounded), and the bounds:
    (value registers, 2) float32, low and high.
    """
    middle, at_middle = np.empty((tape.places, 1)), np.empty((tape.values, 1), np.float32)
    low = 0.5 * box[:, 0] + 0.5 * box[:, 1]
    density = np.empty((1, 1), np.float32)
    run(tape.code, tape.numbers, tape.keys, 0, 0, low, 1.0, 1, middle, at_middle, *scratch(), density)
    places, values = np.empty((tape.places, 2)), np.empty((tape.values, 2), np.float32)
    places[:3] = box
    return bound(tape.code, tape.numbers, middle, at_middle, any_seed, places, values), values


@kernel
def bound(
    code: _Code,
    numbers: _Doubles,
    middle: _Doubles,
    at_middle: _Floats,
    any_seed: bool,
    places: _Doubles,
    values: _Floats,
) -> int:
    """Write the bounds of every register; return ALL_FINITE or the first instruction that is not finite.

    middle: (coordinate registers, 1), at_middle: (value registers, 1): what they are at the middle of the box.
    places: (coordinate registers, 2) and values: (value registers, 2) out, but for the first three places, the box.
    """
    for at in range(code.shape[0]):
        row = code[at]
        op, n = row[ops.CODE], numbers[row[ops.NUMBERS] :]
        a, b, c = values[row[ops.A]], values[row[ops.B]], values[row[ops.C]]
        x, y, z = places[row[ops.X]], places[row[ops.Y]], places[row[ops.Z]]
        if op <= ops.COORDINATE_LAST:
            if not _move(op, x, y, z, a, n, places[row[ops.OUT]]):
                return at
            continue
        out, here = values[row[ops.OUT]], at_middle[row[ops.OUT], 0]
        if op <= ops.ARITHMETIC_LAST:
            _combine(op, a, b, c, x, n, out)
        else:
            flat = op in (ops.GRADIENT2, ops.VALUE2, ops.SIMPLEX2, ops.CELLULAR2)
            dx, dy = _reach(x, middle[row[ops.X], 0]), 0.0 if flat else _reach(y, middle[row[ops.Y], 0])
            dz = _reach(z, middle[row[ops.Z], 0])
            radius, farthest = np.sqrt(dx * dx + dy * dy + dz * dz), max(-x[0], x[1], -y[0], y[1], -z[0], z[1])
            if op <= ops.SHAPE_LAST:
                _distance(here, radius, farthest, n, out)
            elif op == ops.RANDOM:
                known = radius == 0.0 and not any_seed
                out[0], out[1] = (here, here) if known else (np.float32(-1), np.float32(1))
            else:
                _noise(here, at_middle[row[ops.B], 0], ANYWHERE if any_seed else radius, farthest, n, b, out)
        if not (out[0] > -FINITE_MAX and out[1] < FINITE_MAX):
            return at
    return ALL_FINITE


@inlined
def _reach(bound: _Doubles, middle: float) -> float:
    """Return how far a coordinate may be from where it is at the middle."""
    return max(np.float64(bound[1] - middle), np.float64(middle - bound[0]))


@kernel
def _move(op: int, x: _Doubles, y: _Doubles, z: _Doubles, a: _Floats, n: _Doubles, out: _Doubles) -> bool:
    """Bound one coordinate; return whether it is one that noise and `repeat` can take in."""
    if op == ops.AFFINE:
        first, last = x[0] * n[0] + n[1], x[1] * n[0] + n[1]
        out[0], out[1] = min(first, last), max(first, last)
    elif op == ops.TURN:
        x0, x1, y0, y1, z0, z1 = x[0] * n[0], x[1] * n[0], y[0] * n[1], y[1] * n[1], z[0] * n[2], z[1] * n[2]
        out[0] = min(x0, x1) + min(y0, y1) + min(z0, z1)
        out[1] = max(x0, x1) + max(y0, y1) + max(z0, z1)
    elif op == ops.WARP:
        out[0], out[1] = x[0] + np.float64(a[0]), x[1] + np.float64(a[1])
    else:
        if not (max(-x[0], x[1]) * n[1] < COORDINATE_MAX):
            return False
        first, last = cell(x[0], n[0], n[1]), cell(x[1], n[0], n[1])
        if op == ops.CELL:
            out[0], out[1] = first, last
        elif first == last:
            out[0], out[1] = x[0] - n[0] * first, x[1] - n[0] * last
        else:
            half = 0.5 * n[0] + DISTANCE_SLACK * max(-x[0], x[1])
            out[0], out[1] = -half, half
    return bool(out[0] > -FINITE_MAX and out[1] < FINITE_MAX)


@kernel
def _combine(
    op: int,
    a: _Floats,
    b: _Floats,
    c: _Floats,
    x: _Doubles,
    n: _Doubles,
    out: _Floats,
) -> None:
    if op == ops.CONSTANT:
        out[0] = out[1] = np.float32(n[0])
    elif op == ops.COORDINATE:
        out[0], out[1] = np.float32(x[0]), np.float32(x[1])
    elif op == ops.HEIGHT:
        out[0], out[1] = np.float32(x[0] - np.float64(a[1])), np.float32(x[1] - np.float64(a[0]))
    elif op == ops.ADD:
        out[0], out[1] = a[0] + b[0], a[1] + b[1]
    elif op == ops.SUBTRACT:
        out[0], out[1] = a[0] - b[1], a[1] - b[0]
    elif op == ops.MULTIPLY:
        p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
        out[0], out[1] = min(p, q, r, s), max(p, q, r, s)
    elif op == ops.MIN:
        out[0], out[1] = min(a[0], b[0]), min(a[1], b[1])
    elif op == ops.MAX:
        out[0], out[1] = max(a[0], b[0]), max(a[1], b[1])
    elif op in (ops.ABS, ops.FOLD):
        _fold(op, a, b, n, out)
    elif op == ops.SELECT:
        _select(a, b, c, n, out)
    elif op == ops.REMAP:
        _remap(a, n, out)
    else:
        _smooth(op, a, b, n, out)


@kernel
def _fold(op: int, a: _Floats, b: _Floats, n: _Doubles, out: _Floats) -> None:
    inner = np.float32(0) if a[0] <= 0 <= a[1] else min(abs(a[0]), abs(a[1]))
    outer = max(abs(a[0]), abs(a[1]))
    if op == ops.ABS:
        out[0], out[1] = inner, outer
    else:
        base, slope = np.float32(n[0]), np.float32(n[1])
        p, q = np.float32(base + np.float32(slope * inner)), np.float32(base + np.float32(slope * outer))
        out[0], out[1] = b[0] + min(p, q), b[1] + max(p, q)


@kernel
def _select(by: _Floats, below: _Floats, above: _Floats, n: _Doubles, out: _Floats) -> None:
    first, last = np.float32(n[0]), np.float32(n[1])
    if by[1] <= first and by[1] < last:
        out[0], out[1] = below[0], below[1]
    elif by[0] >= last:
        out[0], out[1] = above[0], above[1]
    else:
        low, high = min(below[0], above[0]), max(below[1], above[1])
        slack = SLACK * max(abs(low), abs(high))
        out[0], out[1] = low - slack, high + slack


@kernel
def _smooth(op: int, a: _Floats, b: _Floats, n: _Doubles, out: _Floats) -> None:
    """Bound the smooth minimum and maximum, which rise with a and with b."""
    radius, scale = np.float32(n[0]), np.float32(n[1])
    if op == ops.SMOOTH_MIN:
        low, high = smooth_min(a[0], b[0], radius, scale), smooth_min(a[1], b[1], radius, scale)
    else:
        low, high = -smooth_min(-a[0], -b[0], radius, scale), -smooth_min(-a[1], -b[1], radius, scale)
    slack = SLACK * (max(abs(a[0]), abs(a[1]), abs(b[0]), abs(b[1])) + n[0])
    out[0], out[1] = low - slack, high + slack


@kernel
def _remap(a: _Floats, n: _Doubles, out: _Floats) -> None:
    """Bound a piecewise linear curve: it is lowest and highest at the ends, or at knots between them."""
    first = last = np.float32(n[2])
    low, high, highest = INFINITE, -INFINITE, ZERO
    for knot in range(np.int64(n[0])):
        at = 1 + ops.KNOT_NUMBERS * knot
        start, to = np.float32(n[at]), np.float32(n[at + 1])
        rise, scale = np.float32(n[at + 2]), np.float32(n[at + 3])
        if knot + 1 < n[0]:
            first, last = piece(first, a[0], start, rise, scale), piece(last, a[1], start, rise, scale)
        highest = max(highest, abs(to))
        if a[0] <= start <= a[1]:
            low, high = min(low, to), max(high, to)
    slack = SLACK * n[0] * highest
    out[0], out[1] = min(low, first, last) - slack, max(high, first, last) + slack


@kernel
def _distance(here: np.float32, radius: float, farthest: float, n: _Doubles, out: _Floats) -> None:
    middle = np.float64(here)
    slack = radius + DISTANCE_SLACK * (farthest + n[2]) + SLACK * abs(middle)
    low = max(middle - slack, n[0] + n[1])
    out[0], out[1] = np.float32(low), np.float32(middle + slack)


@kernel
def _noise(
    here: np.float32,
    below_here: np.float32,
    radius: float,
    farthest: float,
    n: _Doubles,
    below: _Floats,
    out: _Floats,
) -> None:
    """Bound below + amplitude * noise."""
    if not (farthest * n[1] + 1.0 < COORDINATE_MAX):
        out[0], out[1] = -INFINITE, INFINITE
        return
    amplitude, middle = np.float32(n[0]), np.float64(here) - np.float64(below_here)
    moved = radius * n[1] + LATTICE_SLACK * (farthest * n[1] + 1.0)
    reach = abs(n[0]) * (n[ops.NOISE_LIPSCHITZ] * moved + NOISE_SLACK)
    reach += SLACK * (abs(here) + abs(below_here))
    first, last = (
        np.float32(amplitude * np.float32(n[ops.NOISE_LOW])),
        np.float32(amplitude * np.float32(n[ops.NOISE_HIGH])),
    )
    low, high = np.float32(max(middle - reach, min(first, last))), np.float32(min(middle + reach, max(first, last)))
    out[0], out[1] = below[0] + low, below[1] + high
