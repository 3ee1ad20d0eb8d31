"""Noise, one point at a time, written so that the loops that call it vectorise: hashes and blends, no table gathers.

A point is split per axis, in float64, into an integer lattice cell and a float32 fraction; everything after that works
on small numbers, so noise is as smooth at 2**40 voxels as at the origin. A lattice corner's hash is a linear form of
all 64 bits of its integer coordinates, finished by mixing rounds; the corner's gradient is picked by bits of the hash.

Only + - * / floor and comparisons: the same bits on every machine.
"""

import math
from typing import Final

import numpy as np

from chunkserver.kernel import inlined


def _sqrt_bits(n: int) -> np.uint64:
    """Return the first 64 fractional bits of sqrt(n), made odd: a multiplier that nobody chose."""
    return np.uint64(math.isqrt(n << 128) & ((1 << 64) - 1) | 1)


# A lattice corner's hash starts as x * AXIS_X + y * AXIS_Y + z * AXIS_Z + key, modulo 2**64.
AXIS_X: Final = _sqrt_bits(2)
AXIS_Y: Final = _sqrt_bits(3)
AXIS_Z: Final = _sqrt_bits(5)

# The finishing rounds of MurmurHash3 (A. Appleby), 32-bit.
ROUND_1: Final = np.uint32(0x85EBCA6B)
ROUND_2: Final = np.uint32(0xC2B2AE35)

INTEGER_IN_LOW_BITS: Final = 1.5 * 2.0**52

ZERO: Final = np.float32(0)
ONE: Final = np.float32(1)
THIRD: Final = np.float32(1 / 3)
SIXTH: Final = np.float32(1 / 6)
HALF: Final = np.float32(1 / 2)

SIMPLEX_REACH: Final = np.float32(0.5)
"""Squared radius of a corner's kernel: the largest that ends inside the simplices around it, so there is no step."""
SIMPLEX_SCALE: Final = np.float32(76.8)
"""Brings simplex noise into [-1, 1]: its supremum is 1/76.88, found by a search over points and gradients."""

GRADIENT_SCALE: Final = np.float32(1.414)
"""Brings 2-D gradient noise with unit gradients into [-1, 1]: its supremum is at most sqrt(1/2)."""

# Sixteen unit gradients, 22.5 degrees apart, none along an axis or a diagonal: at 11.25 and 33.75 degrees and their
# reflections. By half-angle formulas, since sqrt is exact and cos need not be.
COS_1: Final = np.float32(math.sqrt(2 + math.sqrt(2 + math.sqrt(2))) / 2)
SIN_1: Final = np.float32(math.sqrt(2 - math.sqrt(2 + math.sqrt(2))) / 2)
COS_3: Final = np.float32(math.sqrt(2 + math.sqrt(2 - math.sqrt(2))) / 2)
SIN_3: Final = np.float32(math.sqrt(2 - math.sqrt(2 - math.sqrt(2))) / 2)


@inlined
def lattice_integer(whole: float) -> np.uint64:
    """Return a whole number, |whole| < 2**51, as a two's complement integer, modulo 2**51 and a constant.

    Adding 1.5 * 2**52 leaves the integer in the low bits of the float. Most CPUs cannot convert a vector of float64 to
    int64; all can do this. Every use is hashed, so the constant in the high bits does not matter.
    """
    return np.float64(whole + INTEGER_IN_LOW_BITS).view(np.uint64)


@inlined
def mix(corner: np.uint64) -> np.uint32:
    """Return 32 well-mixed bits of a lattice corner's linear hash."""
    bits = np.uint32(corner ^ (corner >> np.uint64(32)))
    bits = np.uint32((bits ^ (bits >> np.uint32(16))) * ROUND_1)
    bits = np.uint32((bits ^ (bits >> np.uint32(13))) * ROUND_2)
    return np.uint32(bits ^ (bits >> np.uint32(16)))


@inlined
def gradient2(x: float, z: float, key: np.uint64) -> np.float32:
    """Gradient (Perlin) noise at (x, z), in lattice cells: float32 in [-1, 1], 0 on the lattice.

    Source: K. Perlin, "Improving Noise" (2002): the quintic blend.
    """
    cell_x, cell_z = np.floor(x), np.floor(z)
    fx, fz = np.float32(x - cell_x), np.float32(z - cell_z)
    corner = lattice_integer(cell_x) * AXIS_X + lattice_integer(cell_z) * AXIS_Z + key
    g00 = _dot2(mix(corner), fx, fz)
    g10 = _dot2(mix(corner + AXIS_X), np.float32(fx - ONE), fz)
    g01 = _dot2(mix(corner + AXIS_Z), fx, np.float32(fz - ONE))
    g11 = _dot2(mix(corner + AXIS_X + AXIS_Z), np.float32(fx - ONE), np.float32(fz - ONE))
    blend_x, blend_z = _quintic(fx), _quintic(fz)
    low = np.float32(g00 + np.float32(blend_x * np.float32(g10 - g00)))
    high = np.float32(g01 + np.float32(blend_x * np.float32(g11 - g01)))
    return np.float32(GRADIENT_SCALE * np.float32(low + np.float32(blend_z * np.float32(high - low))))


@inlined
def _dot2(bits: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of one of sixteen unit gradients with (dx, dz)."""
    cos = COS_1 if bits & np.uint32(1) else COS_3
    sin = SIN_1 if bits & np.uint32(1) else SIN_3
    long = dz if bits & np.uint32(2) else dx
    short = dx if bits & np.uint32(2) else dz
    a = np.float32(cos * long)
    b = np.float32(sin * short)
    a = np.float32(-a) if bits & np.uint32(4) else a
    b = np.float32(-b) if bits & np.uint32(8) else b
    return np.float32(a + b)


@inlined
def _quintic(t: np.float32) -> np.float32:
    """Return 6t^5 - 15t^4 + 10t^3: 0 to 1 with two zero derivatives at both ends."""
    inner = np.float32(t * np.float32(np.float32(t * np.float32(6)) - np.float32(15)) + np.float32(10))
    return np.float32(np.float32(np.float32(t * t) * t) * inner)


@inlined
def simplex3(x: float, y: float, z: float, key: np.uint64) -> np.float32:
    """Simplex noise at (x, y, z), in lattice cells: float32 in [-1, 1], mean 0.

    Space is skewed along its diagonal so that cubes fall into six tetrahedra each; the point's tetrahedron is walked from
    its low corner to its high corner, one axis a step, the axis of the largest coordinate first:

        corner 0 --(largest)--> corner 1 --(middle)--> corner 2 --(smallest)--> corner 3

    With the point split into cell (integers, sum 3q + r) and fraction f, the skew (x+y+z)/3 is q + (r + sum f)/3 and the
    unskew takes q away again: only small numbers are left. Source: K. Perlin, "Noise hardware" (2001); the split is ours.
    """
    cell_x, cell_y, cell_z = np.floor(x), np.floor(y), np.floor(z)
    fx, fy, fz = np.float32(x - cell_x), np.float32(y - cell_y), np.float32(z - cell_z)
    total = cell_x + cell_y + cell_z
    quotient = np.floor(total / 3.0)
    rest = np.float32(total - 3.0 * quotient)

    skew = np.float32(np.float32(rest + np.float32(np.float32(fx + fy) + fz)) * THIRD)
    ax, ay, az = np.floor(np.float32(fx + skew)), np.floor(np.float32(fy + skew)), np.floor(np.float32(fz + skew))
    unskew = np.float32(np.float32(rest + np.float32(np.float32(ax + ay) + az)) * SIXTH)
    dx = np.float32(np.float32(fx - ax) + unskew)
    dy = np.float32(np.float32(fy - ay) + unskew)
    dz = np.float32(np.float32(fz - az) + unskew)

    x_over_y, y_over_z, x_over_z = dx >= dy, dy >= dz, dx >= dz
    # Which axes the first one and the first two steps of the walk have taken.
    x1, y1, z1 = x_over_y & x_over_z, (not x_over_y) & y_over_z, (not x_over_z) & (not y_over_z)
    x2, y2, z2 = x_over_y | x_over_z, (not x_over_y) | y_over_z, (not x_over_z) | (not y_over_z)

    corner = (
        lattice_integer(cell_x + quotient + ax) * AXIS_X
        + lattice_integer(cell_y + quotient + ay) * AXIS_Y
        + lattice_integer(cell_z + quotient + az) * AXIS_Z
        + key
    )
    value = _simplex_corner(mix(corner), dx, dy, dz)
    value += _simplex_step(corner, x1, y1, z1, dx, dy, dz, SIXTH)
    value += _simplex_step(corner, x2, y2, z2, dx, dy, dz, THIRD)
    value += _simplex_step(corner, True, True, True, dx, dy, dz, HALF)
    return np.float32(value * SIMPLEX_SCALE)


@inlined
def _simplex_step(
    corner: np.uint64, x: bool, y: bool, z: bool, dx: np.float32, dy: np.float32, dz: np.float32, unskew: np.float32
) -> np.float32:
    """Return the contribution of the corner that lies one step along each of the axes named by x, y, z."""
    none = np.uint64(0)
    corner += (AXIS_X if x else none) + (AXIS_Y if y else none) + (AXIS_Z if z else none)
    dx = np.float32(np.float32(dx - (ONE if x else ZERO)) + unskew)
    dy = np.float32(np.float32(dy - (ONE if y else ZERO)) + unskew)
    dz = np.float32(np.float32(dz - (ONE if z else ZERO)) + unskew)
    return _simplex_corner(mix(corner), dx, dy, dz)


@inlined
def _simplex_corner(bits: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Return one corner's kernel times its gradient, one of the twelve (+-1, +-1, 0) and their permutations."""
    zero_axis = np.uint32((np.uint32(bits >> np.uint32(16)) * np.uint32(3)) >> np.uint32(16))
    u = dy if zero_axis == np.uint32(0) else dx
    v = dy if zero_axis == np.uint32(2) else dz
    u = np.float32(-u) if bits & np.uint32(1) else u
    v = np.float32(-v) if bits & np.uint32(2) else v
    square = np.float32(np.float32(np.float32(dx * dx) + np.float32(dy * dy)) + np.float32(dz * dz))
    left = np.float32(SIMPLEX_REACH - square)
    left = left if left > ZERO else ZERO
    left = np.float32(left * left)
    return np.float32(np.float32(left * left) * np.float32(u + v))
