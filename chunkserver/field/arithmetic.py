"""Densities made of densities: loops over value registers, one step rounded to float32 at a time."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.kernel import inlined, kernel

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]

ZERO = np.float32(0)
ONE = np.float32(1)


@kernel
def combine(op: int, a: _Floats, b: _Floats, c: _Floats, x: _Doubles, numbers: _Doubles, out: _Floats) -> None:
    """Write the value that instruction `op` makes of values a, b, c (n,) and coordinate x (n,)."""
    if op == ops.CONSTANT:
        out[:] = np.float32(numbers[0])
    elif op == ops.COORDINATE:
        for i in range(out.size):
            out[i] = np.float32(x[i])
    elif op == ops.HEIGHT:
        for i in range(out.size):
            out[i] = np.float32(x[i] - np.float64(a[i]))
    elif op == ops.REMAP:
        _remap(a, numbers, out)
    elif op <= ops.MAX:
        _two(op, a, b, out)
    else:
        _shaped(op, a, b, c, numbers, out)


@kernel
def _two(op: int, a: _Floats, b: _Floats, out: _Floats) -> None:
    if op == ops.ADD:
        for i in range(out.size):
            out[i] = a[i] + b[i]
    elif op == ops.SUBTRACT:
        for i in range(out.size):
            out[i] = a[i] - b[i]
    elif op == ops.MULTIPLY:
        for i in range(out.size):
            out[i] = a[i] * b[i]
    elif op == ops.MIN:
        for i in range(out.size):
            out[i] = a[i] if a[i] < b[i] else b[i]
    else:
        for i in range(out.size):
            out[i] = a[i] if a[i] > b[i] else b[i]


@kernel
def _shaped(op: int, a: _Floats, b: _Floats, c: _Floats, numbers: _Doubles, out: _Floats) -> None:
    n0, n1, n2 = np.float32(numbers[0]), np.float32(numbers[1]), np.float32(numbers[2])
    if op == ops.ABS:
        for i in range(out.size):
            out[i] = abs(a[i])
    elif op == ops.FOLD:
        for i in range(out.size):
            out[i] = fold(a[i], b[i], n0, n1)
    elif op == ops.SMOOTH_MIN:
        for i in range(out.size):
            out[i] = smooth_min(a[i], b[i], n0, n1)
    elif op == ops.SMOOTH_MAX:
        for i in range(out.size):
            out[i] = -smooth_min(-a[i], -b[i], n0, n1)
    else:
        for i in range(out.size):
            out[i] = select(a[i], b[i], c[i], n0, n1, n2)


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


@kernel
def _remap(a: _Floats, numbers: _Doubles, out: _Floats) -> None:
    """Write the first knot's value, plus each piece's rise by how far along it the argument is."""
    out[:] = np.float32(numbers[2])
    for knot in range(np.int64(numbers[0]) - 1):
        at = 1 + ops.KNOT_NUMBERS * knot
        start, rise, scale = np.float32(numbers[at]), np.float32(numbers[at + 2]), np.float32(numbers[at + 3])
        for i in range(out.size):
            out[i] = piece(out[i], a[i], start, rise, scale)


@inlined
def piece(below: np.float32, a: np.float32, start: np.float32, rise: np.float32, scale: np.float32) -> np.float32:
    """Return `below` plus as much of `rise` as lies between start and a, where scale = 1 / (stop - start)."""
    t = _share(np.float32(np.float32(a - start) * scale))
    return np.float32(below + np.float32(rise * t))
