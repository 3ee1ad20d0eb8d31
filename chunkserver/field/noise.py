"""Noise over a block of points: hashes and blends, no table gathers, written so that the loops vectorise.

    loop 1, 64-bit lanes    a coordinate -> the whole number nearest to it, and the small fraction that is left
    loop 2, 32-bit lanes    everything else: corners, hashes, gradients, kernels

Two loops, because a loop runs at the width of its widest type: one loop over both would do the long part at half width.
What passes between them is a block of BLOCK points that stays in the first-level cache. Once the whole number is split
off, only small numbers are left: noise is as smooth at 2**40 voxels as at the origin.

A lattice corner is hashed axis by axis, from all 64 bits of its coordinate, and the axes' hashes are added and stirred
once more; the corner's gradient is picked by the top bits. The stirring of each axis breaks up what a linear hash
would have: a vector by which all noise can be shifted onto itself.

Only + - * and comparisons: the same bits on every machine. `tests/reference/field_twin.py` says it all again in plain
Python, point by point.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined, kernel

BLOCK: Final = 256
"""Points at a time: loop 2 of simplex noise reads 10 words a point, 10 KB a block."""
FRACTION_ROWS: Final = 4
WORD_ROWS: Final = 6

COORDINATE_MAX: Final = 2.0**50
"""Noise is defined for coordinates, in lattice cells, up to this magnitude."""

_ROUNDER: Final = 1.5 * 2.0**52
_ROUNDER_32: Final = np.float32(1.5 * 2.0**23)


def _sqrt_bits(n: int) -> np.uint32:
    """Return the first 32 fractional bits of sqrt(n), made odd: a multiplier that nobody chose."""
    return np.uint32(math.isqrt(n << 64) & 0xFFFFFFFF | 1)


AXIS_X: Final = _sqrt_bits(2)
AXIS_Y: Final = _sqrt_bits(3)
AXIS_Z: Final = _sqrt_bits(5)
PAGE: Final = _sqrt_bits(7)
ROUND_1: Final = np.uint32(0x85EBCA6B)
ROUND_2: Final = np.uint32(0xC2B2AE35)
"""The multipliers of MurmurHash3's finish (A. Appleby)."""

ZERO: Final = np.float32(0)
ONE: Final = np.float32(1)
HALF: Final = np.float32(1 / 2)
THIRD: Final = np.float32(1 / 3)
SIXTH: Final = np.float32(1 / 6)
_STEP_1: Final = np.float32(1 / 6 - 1)
_STEP_2: Final = np.float32(1 / 3 - 1)
_SIGN: Final = np.uint32(1 << 31)
_FIRST_THIRD: Final = np.int32(-(2**32 // 6))
_LAST_THIRD: Final = np.int32(2**32 // 6)

SIMPLEX_REACH: Final = np.float32(0.5)
"""Squared radius of a corner's kernel: the largest that ends inside the simplices around it, so there is no step."""
SIMPLEX_SCALE: Final = np.float32(76.8)
"""Brings simplex noise into [-1, 1]: its supremum is 1/76.88, found by a search over points and gradients."""

GRADIENT_SCALE: Final = np.float32(1.437)
"""Brings 2-D gradient noise with the gradients below into [-1, 1]: its supremum is 1/1.4381, found in the same way."""

# Sixteen unit gradients, 22.5 degrees apart, none along an axis or a diagonal: at 11.25 and 33.75 degrees and their
# reflections. By half-angle formulas, since sqrt is exact and cos need not be.
COS_1: Final = np.float32(math.sqrt(2 + math.sqrt(2 + math.sqrt(2))) / 2)
SIN_1: Final = np.float32(math.sqrt(2 - math.sqrt(2 + math.sqrt(2))) / 2)
COS_3: Final = np.float32(math.sqrt(2 + math.sqrt(2 - math.sqrt(2))) / 2)
SIN_3: Final = np.float32(math.sqrt(2 - math.sqrt(2 - math.sqrt(2))) / 2)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]


def scratch() -> tuple[_Floats, _Words]:
    """Return the two arrays that pass a block from loop 1 to loop 2: rows of BLOCK fractions, rows of BLOCK words."""
    return np.empty(FRACTION_ROWS * BLOCK, np.float32), np.empty(WORD_ROWS * BLOCK, np.uint32)


@inlined
def nearest(x: float) -> tuple[float, np.uint64]:
    """Return the whole number nearest to x, |x| < 2**51, as a float and as a two's complement integer.

    At 1.5 * 2**52 floats are the whole numbers, so the sum is rounded to one and holds it in its low bits. Many CPUs
    can convert no vector of float64 to int64, and without SSE4 not even round one; all can add. The exponent that stays
    in the integer's high bits is the same for all, so it only shifts what is hashed.
    """
    shifted = np.float64(x + _ROUNDER)
    return shifted - _ROUNDER, shifted.view(np.uint64)


@inlined
def _floor32(x: np.float32) -> np.float32:
    """Return the whole number below x, |x| < 2**21; at a whole number either it or the one below."""
    return np.float32(np.float32(np.float32(x - HALF) + _ROUNDER_32) - _ROUNDER_32)


@inlined
def axis_hashes(
    low: np.uint32, high: np.uint32, up: np.uint32, axis: np.uint32, key: np.uint32
) -> tuple[np.uint32, np.uint32]:
    """Return the hashes of coordinate i + up and of i + up + 1, where i has words `low` and `high` and up < 2**31."""
    word = np.uint32(low + up)
    carry = np.uint32((low & ~word) >> np.uint32(31))
    first = np.uint32(np.uint32(word * axis) + np.uint32(np.uint32(np.uint32(high + carry) * PAGE) + key))
    turns = PAGE if word == np.uint32(0xFFFFFFFF) else np.uint32(0)
    return _stir(first, ROUND_1), _stir(np.uint32(np.uint32(first + axis) + turns), ROUND_1)


@inlined
def _stir(bits: np.uint32, multiplier: np.uint32) -> np.uint32:
    """Return `bits` with the high half folded onto the low one and multiplied up again: the top bits depend on all."""
    return np.uint32((bits ^ (bits >> np.uint32(16))) * multiplier)


@inlined
def _flip(value: np.float32, bits: np.uint32) -> np.float32:
    """Return `value` with its sign flipped if the top bit is set."""
    flipped: Any = np.uint32(np.float32(value).view(np.uint32) ^ (bits & _SIGN))
    return np.float32(flipped.view(np.float32))


@kernel
def add_gradient2(
    x: _Doubles,
    z: _Doubles,
    numbers: _Doubles,
    keys: _Words,
    below: _Floats,
    out: _Floats,
    fractions: _Floats,
    words: _Words,
) -> None:
    """Write below + amplitude * gradient (Perlin) noise in [-1, 1], 0 on the lattice, mean 0.

    x, z: (n,) voxels. numbers: amplitude, frequency, offsets of x, y, z. keys: (3,) of x, y, z. below, out: (n,).

    Source: K. Perlin, "Improving Noise" (2002): the quintic blend. A cell is the unit square around a whole number.
    """
    amplitude, frequency, offset_x, offset_z = np.float32(numbers[0]), numbers[1], numbers[2], numbers[4]
    key_x, key_z = keys[0], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        xs, zs, belows, outs = x[start:stop], z[start:stop], below[start:stop], out[start:stop]
        for i in range(stop - start):
            px, pz = xs[i] * frequency + offset_x, zs[i] * frequency + offset_z
            (cell_x, ix), (cell_z, iz) = nearest(px), nearest(pz)
            fractions[i], fractions[i + BLOCK] = px - cell_x, pz - cell_z
            words[i], words[i + BLOCK] = ix, ix >> np.uint64(32)
            words[i + 2 * BLOCK], words[i + 3 * BLOCK] = iz, iz >> np.uint64(32)
        for i in range(stop - start):
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], np.uint32(0), AXIS_X, key_x)
            z0, z1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], np.uint32(0), AXIS_Z, key_z)
            noise = _gradient2(fractions[i], fractions[i + BLOCK], x0, x1, z0, z1)
            outs[i] = belows[i] + np.float32(amplitude * noise)


@inlined
def _gradient2(
    fx: np.float32, fz: np.float32, x0: np.uint32, x1: np.uint32, z0: np.uint32, z1: np.uint32
) -> np.float32:
    """Return gradient noise at (fx, fz) from the middle of a cell whose corners have these hashes per axis."""
    left, right = np.float32(fx + HALF), np.float32(fx - HALF)
    near, far = np.float32(fz + HALF), np.float32(fz - HALF)
    g00 = _dot2(np.uint32(x0 + z0), left, near)
    g10 = _dot2(np.uint32(x1 + z0), right, near)
    g01 = _dot2(np.uint32(x0 + z1), left, far)
    g11 = _dot2(np.uint32(x1 + z1), right, far)
    blend_x, blend_z = _quintic(left), _quintic(near)
    low = np.float32(g00 + np.float32(blend_x * np.float32(g10 - g00)))
    high = np.float32(g01 + np.float32(blend_x * np.float32(g11 - g01)))
    return np.float32(GRADIENT_SCALE * np.float32(low + np.float32(blend_z * np.float32(high - low))))


@inlined
def _dot2(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of one of sixteen unit gradients with (dx, dz)."""
    bits = _stir(sum_of_axes, ROUND_2)
    steep, swap = bits & np.uint32(1 << 29), bits & np.uint32(1 << 28)
    long = np.float32((COS_3 if steep else COS_1) * (dz if swap else dx))
    short = np.float32((SIN_3 if steep else SIN_1) * (dx if swap else dz))
    return np.float32(_flip(long, bits) + _flip(short, np.uint32(bits << np.uint32(1))))


@inlined
def _quintic(t: np.float32) -> np.float32:
    """Return 6t^5 - 15t^4 + 10t^3: 0 to 1 with two zero derivatives at both ends."""
    inner = np.float32(t * np.float32(np.float32(t * np.float32(6)) - np.float32(15)) + np.float32(10))
    return np.float32(np.float32(np.float32(t * t) * t) * inner)


@kernel
def add_simplex3(
    x: _Doubles,
    y: _Doubles,
    z: _Doubles,
    numbers: _Doubles,
    keys: _Words,
    below: _Floats,
    out: _Floats,
    fractions: _Floats,
    words: _Words,
) -> None:
    """Write below + amplitude * simplex noise in [-1, 1], mean 0. Arguments as in `add_gradient2`.

    Space is skewed along its diagonal, p -> p + sum(p)/3, so that cubes fall into six tetrahedra each. With p split
    into cell c and fraction f, and sum(c) = 3q + r, the skew is q + (r + sum f)/3: any whole q near sum(c)/3 leaves
    small numbers only. The low corner of the point's cube is c + q + a, where a = floor(f + (r + sum f)/3); unskewed
    it lies at c + a - (r + sum a)/6, from which q is gone. q is taken two too low: then a is 0 to 3, never negative.

    Source: K. Perlin, "Noise hardware" (2001); the split is ours.
    """
    amplitude, frequency = np.float32(numbers[0]), numbers[1]
    offset_x, offset_y, offset_z = numbers[2], numbers[3], numbers[4]
    key_x, key_y, key_z = keys[0], keys[1], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        xs, ys, zs, belows, outs = x[start:stop], y[start:stop], z[start:stop], below[start:stop], out[start:stop]
        for i in range(stop - start):
            px, py, pz = xs[i] * frequency + offset_x, ys[i] * frequency + offset_y, zs[i] * frequency + offset_z
            (cell_x, ix), (cell_y, iy), (cell_z, iz) = nearest(px), nearest(py), nearest(pz)
            total = cell_x + cell_y + cell_z
            q, iq = nearest(total * (1 / 3) - 2.0)
            fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK] = px - cell_x, py - cell_y, pz - cell_z
            fractions[i + 3 * BLOCK] = total - 3.0 * q
            ix, iy, iz = ix + iq, iy + iq, iz + iq
            words[i], words[i + BLOCK] = ix, ix >> np.uint64(32)
            words[i + 2 * BLOCK], words[i + 3 * BLOCK] = iy, iy >> np.uint64(32)
            words[i + 4 * BLOCK], words[i + 5 * BLOCK] = iz, iz >> np.uint64(32)
        for i in range(stop - start):
            fx, fy, fz = fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK]
            ax, ay, az, dx, dy, dz = _simplex_cell(fx, fy, fz, fractions[i + 3 * BLOCK])
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], ax, AXIS_X, key_x)
            y0, y1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], ay, AXIS_Y, key_y)
            z0, z1 = axis_hashes(words[i + 4 * BLOCK], words[i + 5 * BLOCK], az, AXIS_Z, key_z)
            noise = _simplex3(dx, dy, dz, x0, x1, y0, y1, z0, z1)
            outs[i] = belows[i] + np.float32(amplitude * noise)


@inlined
def _simplex_cell(
    fx: np.float32, fy: np.float32, fz: np.float32, rest: np.float32
) -> tuple[np.uint32, np.uint32, np.uint32, np.float32, np.float32, np.float32]:
    """Return a, the low corner of the point's skewed cube, and the point relative to that corner, unskewed."""
    skew = np.float32(np.float32(np.float32(fx + fy) + np.float32(fz + rest)) * THIRD)
    ax, ay, az = _floor32(np.float32(fx + skew)), _floor32(np.float32(fy + skew)), _floor32(np.float32(fz + skew))
    unskew = np.float32(np.float32(np.float32(ax + ay) + np.float32(az + rest)) * SIXTH)
    dx, dy, dz = np.float32(fx - ax) + unskew, np.float32(fy - ay) + unskew, np.float32(fz - az) + unskew
    return np.uint32(np.int32(ax)), np.uint32(np.int32(ay)), np.uint32(np.int32(az)), dx, dy, dz


@inlined
def _simplex3(
    dx: np.float32,
    dy: np.float32,
    dz: np.float32,
    x0: np.uint32,
    x1: np.uint32,
    y0: np.uint32,
    y1: np.uint32,
    z0: np.uint32,
    z1: np.uint32,
) -> np.float32:
    """Return simplex noise at (dx, dy, dz) from the low corner of a cube with these hashes per axis, low and high.

    The point's tetrahedron is walked from the cube's low corner to its high corner, one axis a step, the axis of the
    largest coordinate first:

        corner 0 --(largest)--> corner 1 --(middle)--> corner 2 --(smallest)--> corner 3
    """
    x_over_y, y_over_z, x_over_z = dx >= dy, dy >= dz, dx >= dz
    # Which axes the first one and the first two steps of the walk have taken.
    sx, sy, sz = x_over_y & x_over_z, (not x_over_y) & y_over_z, not (x_over_z | y_over_z)
    tx, ty, tz = x_over_y | x_over_z, (not x_over_y) | y_over_z, not (x_over_z & y_over_z)
    corner_1 = np.uint32((x1 if sx else x0) + (y1 if sy else y0) + (z1 if sz else z0))
    corner_2 = np.uint32((x1 if tx else x0) + (y1 if ty else y0) + (z1 if tz else z0))
    value = _simplex_corner(np.uint32(x0 + y0 + z0), dx, dy, dz)
    value += _simplex_corner(
        corner_1,
        np.float32(dx + (_STEP_1 if sx else SIXTH)),
        np.float32(dy + (_STEP_1 if sy else SIXTH)),
        np.float32(dz + (_STEP_1 if sz else SIXTH)),
    )
    value += _simplex_corner(
        corner_2,
        np.float32(dx + (_STEP_2 if tx else THIRD)),
        np.float32(dy + (_STEP_2 if ty else THIRD)),
        np.float32(dz + (_STEP_2 if tz else THIRD)),
    )
    value += _simplex_corner(
        np.uint32(x1 + y1 + z1), np.float32(dx - HALF), np.float32(dy - HALF), np.float32(dz - HALF)
    )
    return np.float32(value * SIMPLEX_SCALE)


@inlined
def _simplex_corner(sum_of_axes: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Return one corner's kernel times its gradient, one of the twelve (+-1, +-1, 0) and their permutations."""
    bits = _stir(sum_of_axes, ROUND_2)
    # Two bits are the signs; the rest, as a signed number, falls into one of three thirds and names the axis left out.
    third = np.int32(np.uint32(bits << np.uint32(2)))
    u = dy if third < _FIRST_THIRD else dx
    v = dy if third > _LAST_THIRD else dz
    slope = np.float32(_flip(u, bits) + _flip(v, np.uint32(bits << np.uint32(1))))
    square = np.float32(np.float32(np.float32(dx * dx) + np.float32(dy * dy)) + np.float32(dz * dz))
    left = np.float32(SIMPLEX_REACH - square)
    left = left if left > ZERO else ZERO
    left = np.float32(left * left)
    return np.float32(np.float32(left * left) * slope)
