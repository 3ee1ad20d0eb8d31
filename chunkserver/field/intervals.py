"""The same tape over boxes instead of points: bounds that hold for every sample in them.

Bounds are kept in the types of the registers and worked out with the interpreter's own operations. One such operation,
rounded to nearest, never decreases where its exact result increases, so bounds of it are exact bounds of what is
computed: nothing has to be rounded outwards. Where a step is more than one operation, or is bounded by how steep it is,
the bounds are widened by more than its rounding: see SLACK and the others.

What is bounded by how steep it is starts from its value at the middle of the box, where the interpreter has worked out
every register. Noise lies within its range, and within its Lipschitz constant times the distance from there: tight
wherever the box is smaller than a feature. A distance changes by at most as much as the point moves.

Beside its bounds each register has a spread: by how much its value at a point of the box differs at most from its value
at another point, not farther than a patch reaches along each axis. One sample then says what is around it.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.coordinates import cell
from chunkserver.field.noise.lattice import COORDINATE_MAX
from chunkserver.field.points import run_at
from chunkserver.field.tape import INPUTS, Tape
from chunkserver.field.value_bounds import INFINITE, LEAST_SLACK, SLACK, combine_bounds, largest, remap_bounds
from chunkserver.kernel import inlined, kernel

NOISE_SLACK: Final = 2.0**-16
"""Of noise in [-1, 1]: what its roundings in float32 may add up to (`tests/property/test_intervals.py`)."""
DISTANCE_SLACK: Final = 2.0**-40
"""Of the coordinates and of the shape's own numbers: thousands of roundings of float64."""
COORDINATE_SLACK: Final = 2.0**-50
"""Of the magnitudes that a coordinate is made of: eight roundings of float64, more than what may be left of it."""
LATTICE_SLACK: Final = 2.0**-50
"""Of a coordinate in lattice cells: eight roundings of float64, at two points and on three axes."""
FINITE_MAX: Final = 1e38
"""Values are refused from here on: a third of what float32 holds."""
ALL_FINITE: Final = -1
ANYWHERE: Final = math.inf
"""A coordinate that is not known at all; a distance from the middle at which noise is bounded by its range alone."""

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Code = NDArray[np.int32]
_Point = tuple[float, float, float]


class Bounds(NamedTuple):
    """What is known of a tape's values over n boxes.

    failed: (n,) int32, ALL_FINITE or the first instruction that is not finite: then nothing after it is bounded.
    low, high: (value registers, n) float32. spread: (value registers, n) float64.
    """

    failed: NDArray[np.int32]
    low: _Floats
    high: _Floats
    spread: _Doubles


def bounds(tape: Tape, low: _Doubles, high: _Doubles, reach: float = 0.0, any_seed: bool = False) -> Bounds:
    """Bound every register of a tape over boxes.

    tape: one that keeps every step in a register of its own (`tape.allocate`).
    low, high: (3, n) float64, corners x, y, z of the boxes, voxels.
    reach: how far a patch reaches from its middle along each axis, voxels.
    any_seed: bound noise by its range alone, so that the bounds hold for every seed.
    """
    places = np.empty((4, tape.places, low.shape[1]))
    places[0, :INPUTS], places[1, :INPUTS], places[2, :INPUTS] = low, high, reach
    places[3, :INPUTS] = 0.5 * low + 0.5 * high
    return _bounded(tape, places, any_seed)


def bounds_of_box(tape: Tape, low: _Point, high: _Point) -> Bounds:
    """Bound every register of a tape, as `bounds` wants it, over one box with these corners x, y, z, voxels."""
    places = np.empty((4, tape.places, 1))
    middle = [0.5 * first + 0.5 * last for first, last in zip(low, high, strict=True)]
    places[:, :INPUTS, 0] = low, high, (0.0, 0.0, 0.0), middle
    return _bounded(tape, places, any_seed=False)


def _bounded(tape: Tape, places: _Doubles, any_seed: bool) -> Bounds:
    """Return the bounds over boxes whose corners, reach and middles stand in `places`, as in `bound`."""
    n, values = places.shape[2], np.empty((3, tape.values, places.shape[2]), np.float32)
    run_at(tape, places[3:], values[2:])
    found = Bounds(np.empty(n, np.int32), values[0], values[1], np.empty((tape.values, n)))
    bound(tape.code, tape.numbers, any_seed, places, values[2], *found)
    return found


@kernel
def bound(
    code: _Code,
    numbers: _Doubles,
    any_seed: bool,
    places: _Doubles,
    at_middle: _Floats,
    failed: _Code,
    low: _Floats,
    high: _Floats,
    spread: _Doubles,
) -> None:
    """Write the bounds of every register.

    places: (4, coordinate registers, n): low, high and spread, of which the first three registers are given, the boxes,
        and the others written; and what all are at the middles of the boxes. at_middle: (value registers, n) there.
    failed, low, high, spread: out, as in `Bounds`.
    """
    for box in range(failed.size):
        failed[box] = ALL_FINITE
        for at in range(code.shape[0]):
            op, out, a, b, c = code[at, ops.CODE], code[at, ops.OUT], code[at, ops.A], code[at, ops.B], code[at, ops.C]
            x, y, z, n = code[at, ops.X], code[at, ops.Y], code[at, ops.Z], code[at, ops.NUMBERS]
            n0, n1, n2 = numbers[n], numbers[n + 1], numbers[n + 2]
            x0, x1, dx = places[0, x, box], places[1, x, box], places[2, x, box]
            y0, y1, dy = places[0, y, box], places[1, y, box], places[2, y, box]
            z0, z1, dz = places[0, z, box], places[1, z, box], places[2, z, box]
            a0, a1, da = low[a, box], high[a, box], spread[a, box]
            b0, b1, db = low[b, box], high[b, box], spread[b, box]
            if op <= ops.COORDINATE_LAST:
                first, last, moved = _move(op, x0, x1, dx, y0, y1, dy, z0, z1, dz, a0, a1, da, n0, n1, n2)
                places[0, out, box], places[1, out, box], places[2, out, box] = first, last, moved
                finite = bool(first > -FINITE_MAX and last < FINITE_MAX)
            else:
                if op == ops.REMAP:
                    lowest, highest, by = remap_bounds(a0, a1, da, numbers, n)
                elif op <= ops.ARITHMETIC_LAST:
                    c0, c1, dc = low[c, box], high[c, box], spread[c, box]
                    lowest, highest, by = combine_bounds(op, a0, a1, da, b0, b1, db, c0, c1, dc, x0, x1, dx, n0, n1, n2)
                else:
                    flat = op in (ops.GRADIENT2, ops.VALUE2, ops.SIMPLEX2, ops.CELLULAR2)
                    here = at_middle[out, box]
                    rx, rz = _reach(x0, x1, places[3, x, box]), _reach(z0, z1, places[3, z, box])
                    ry, dy = (0.0, 0.0) if flat else (_reach(y0, y1, places[3, y, box]), dy)
                    radius, moved = np.sqrt(rx * rx + ry * ry + rz * rz), np.sqrt(dx * dx + dy * dy + dz * dz)
                    farthest = max(-x0, x1, -y0, y1, -z0, z1)
                    if op <= ops.SHAPE_LAST:
                        lowest, highest, by = _distance(here, radius, moved, farthest, n0, n1, n2)
                    elif op == ops.RANDOM:
                        known = radius == 0.0 and not any_seed
                        lowest, highest = (here, here) if known else (np.float32(-1), np.float32(1))
                        by = 0.0 if moved == 0.0 else 2.0
                    else:
                        range_low, range_high = numbers[n + ops.NOISE_LOW], numbers[n + ops.NOISE_HIGH]
                        steep, below_here = numbers[n + ops.NOISE_LIPSCHITZ], at_middle[b, box]
                        radius = ANYWHERE if any_seed else radius
                        lowest, highest, by = _noise(
                            here, below_here, radius, moved, farthest, n0, n1, range_low, range_high, steep, b0, b1, db
                        )
                low[out, box], high[out, box] = lowest, highest
                spread[out, box] = by + SLACK * largest(lowest, highest) + LEAST_SLACK
                finite = bool(lowest > -FINITE_MAX and highest < FINITE_MAX)
            if not finite:
                failed[box] = at
                break


@inlined
def _reach(low: float, high: float, middle: float) -> float:
    """Return how far a coordinate may be from where it is at the middle."""
    return max(high - middle, middle - low)


@inlined
def _move(
    op: int,
    x0: float,
    x1: float,
    dx: float,
    y0: float,
    y1: float,
    dy: float,
    z0: float,
    z1: float,
    dz: float,
    a0: np.float32,
    a1: np.float32,
    da: float,
    n0: float,
    n1: float,
    n2: float,
) -> tuple[float, float, float]:
    """Bound one coordinate: low, high, spread; infinite where noise and `repeat` cannot take it in."""
    if op == ops.AFFINE:
        first, last = x0 * n0 + n1, x1 * n0 + n1
        size = max(-x0, x1) * abs(n0) + abs(n1)
        return min(first, last), max(first, last), dx * abs(n0) + COORDINATE_SLACK * size
    if op == ops.TURN:
        first = min(x0 * n0, x1 * n0) + min(y0 * n1, y1 * n1) + min(z0 * n2, z1 * n2)
        last = max(x0 * n0, x1 * n0) + max(y0 * n1, y1 * n1) + max(z0 * n2, z1 * n2)
        size = max(-x0, x1) * abs(n0) + max(-y0, y1) * abs(n1) + max(-z0, z1) * abs(n2)
        return first, last, dx * abs(n0) + dy * abs(n1) + dz * abs(n2) + COORDINATE_SLACK * size
    if op == ops.WARP:
        size = max(-x0, x1) + largest(a0, a1)
        return x0 + np.float64(a0), x1 + np.float64(a1), dx + da + COORDINATE_SLACK * size
    period, inverse = n0, n1
    if not (max(-x0, x1) * inverse < COORDINATE_MAX):
        return -ANYWHERE, ANYWHERE, ANYWHERE
    first, last = cell(x0, period, inverse), cell(x1, period, inverse)
    if op == ops.CELL:
        return first, last, last - first
    if first == last:
        return x0 - period * first, x1 - period * last, dx
    half = 0.5 * period + DISTANCE_SLACK * max(-x0, x1)
    return -half, half, 2.0 * half


@inlined
def _distance(
    here: np.float32, radius: float, moved: float, farthest: float, lift: float, least: float, size: float
) -> tuple[np.float32, np.float32, float]:
    middle = np.float64(here)
    rounding = DISTANCE_SLACK * (farthest + size)
    slack = radius + rounding + SLACK * abs(middle)
    low = max(middle - slack, lift + least)
    return np.float32(low), np.float32(middle + slack), moved + 2.0 * rounding


@inlined
def _noise(
    here: np.float32,
    below_here: np.float32,
    radius: float,
    moved: float,
    farthest: float,
    size: float,
    frequency: float,
    range_low: float,
    range_high: float,
    steep: float,
    below0: np.float32,
    below1: np.float32,
    d_below: float,
) -> tuple[np.float32, np.float32, float]:
    """Bound below + amplitude * noise."""
    if not (farthest * frequency + 1.0 < COORDINATE_MAX):
        return -INFINITE, INFINITE, ANYWHERE
    amplitude, middle = np.float32(size), np.float64(here) - np.float64(below_here)
    size = abs(size)
    rounding = LATTICE_SLACK * (farthest * frequency + 1.0)
    reach = size * (steep * (radius * frequency + rounding) + NOISE_SLACK)
    reach += SLACK * np.float64(abs(here) + abs(below_here))
    first = np.float32(amplitude * np.float32(range_low))
    last = np.float32(amplitude * np.float32(range_high))
    low = np.float32(max(middle - reach, np.float64(min(first, last))))
    high = np.float32(min(middle + reach, np.float64(max(first, last))))
    by = size * (steep * (moved * frequency + rounding) + 2.0 * NOISE_SLACK)
    by = min(by, np.float64(abs(last - first))) + SLACK * (size + largest(below0, below1))
    return np.float32(below0 + low), np.float32(below1 + high), d_below + by
