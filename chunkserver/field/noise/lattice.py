"""What all noises share: coordinates split into lattice cells, hashes of lattice points, blends, scratch memory.

    loop 1, 64-bit lanes    a coordinate -> the whole number nearest to it, and the small fraction that is left
    loop 2, 32-bit lanes    everything else: corners, hashes, gradients, kernels

Where points come in rows, loop 1 runs over the x of one row, and the y and z of all rows; the rest of what depends on
one axis is then worked out there too (`blended`, `simplex3`).

Two loops, because a loop runs at the width of its widest type: one loop over both would do the long part at half width.
What passes between them is a block of BLOCK points, which stays in the caches. Once the whole number is split
off, only small numbers are left: noise is as smooth at 2**40 voxels as at the origin.

A lattice point is hashed axis by axis, from all 64 bits of its coordinate, and the axes' hashes are added and stirred
once more; what the point stands for is picked by the top bits. The stirring of each axis breaks up what a linear hash
would have: a vector by which all noise can be shifted onto itself.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import choose, inlined, kernel

BLOCK: Final = 256
"""Points at a time: 1 KB a row of scratch. Cellular noise has 15 rows of four bytes in its loop 2, simplex noise 37."""
ROW: Final = BLOCK + 16
"""Numbers from one row of scratch to the next. At multiples of 1 KB all rows would share a few sets of a cache."""
FRACTION_ROWS: Final = 25
WORD_ROWS: Final = 16
LANES: Final = 8
"""Numbers of 32 bits in a vector of AVX2: rows of points are worked out in whole vectors."""
ROW_LEAST: Final = 16
"""Shorter rows are taken point by point: most of their vectors would be empty."""

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
AXES: Final = AXIS_X, AXIS_Y, AXIS_Z
PAGE: Final = _sqrt_bits(7)
ROUND_1: Final = np.uint32(0x85EBCA6B)
ROUND_2: Final = np.uint32(0xC2B2AE35)
"""The multipliers of MurmurHash3's finish (A. Appleby)."""

ZERO: Final = np.float32(0)
ONE: Final = np.float32(1)
HALF: Final = np.float32(1 / 2)
HERE: Final = np.uint32(0)
"""No steps up from the cell that a coordinate was split into."""
FIRST_THIRD: Final = np.int32(-(2**32 // 6))
LAST_THIRD: Final = np.int32(2**32 // 6)
"""A hash as a signed number falls below, between or above these: three equal parts."""
_SIGN: Final = np.uint32(1 << 31)
_TO_UNIT: Final = np.float32(2.0**-31)
LAST_WORD: Final = np.uint32(0xFFFFFFFF)

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Words = NDArray[np.uint32]


def scratch() -> tuple[Floats, Words]:
    """Return the two arrays that pass a block from loop 1 to loop 2: rows of BLOCK fractions, rows of BLOCK words."""
    return np.empty(FRACTION_ROWS * ROW, np.float32), np.empty(WORD_ROWS * ROW, np.uint32)


@inlined
def whole_vectors(n: int) -> int:
    """Return n, rounded up to whole vectors."""
    return (n + LANES - 1) // LANES * LANES


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
def floor32(x: np.float32) -> np.float32:
    """Return the whole number below x, |x| < 2**21; at a whole number either it or the one below."""
    return np.float32(np.float32(np.float32(x - HALF) + _ROUNDER_32) - _ROUNDER_32)


@inlined
def split(
    axis: int, place: Doubles, first: int, stride: int, n: int, numbers: Doubles, fractions: Floats, words: Words
) -> None:
    """Split n coordinates of one axis, from the `first` on each `stride` after the one before.

    Writes a row of fractions, low and high words.
    """
    places, frequency, offset = place[first:], numbers[1], numbers[2 + axis]
    for i in range(n):
        at = places[i * stride] * frequency + offset
        cell, bits = nearest(at)
        fractions[i] = at - cell
        words[i], words[i + ROW] = bits, bits >> np.uint64(32)


@kernel
def split2(x: Doubles, z: Doubles, numbers: Doubles, fractions: Floats, words: Words) -> None:
    """Split coordinates of up to BLOCK points: rows x, z of fractions, rows x low, x high, z low, z high of words."""
    frequency, offset_x, offset_z = numbers[1], numbers[2], numbers[4]
    for i in range(x.size):
        px, pz = x[i] * frequency + offset_x, z[i] * frequency + offset_z
        (cell_x, ix), (cell_z, iz) = nearest(px), nearest(pz)
        fractions[i], fractions[i + ROW] = px - cell_x, pz - cell_z
        words[i], words[i + ROW] = ix, ix >> np.uint64(32)
        words[i + 2 * ROW], words[i + 3 * ROW] = iz, iz >> np.uint64(32)


@kernel
def split3(x: Doubles, y: Doubles, z: Doubles, numbers: Doubles, fractions: Floats, words: Words) -> None:
    """Split coordinates as `split2` does: rows x, y, z of fractions; low and high words of x, of y, of z."""
    frequency, offset_x, offset_y, offset_z = numbers[1], numbers[2], numbers[3], numbers[4]
    for i in range(x.size):
        px, py, pz = x[i] * frequency + offset_x, y[i] * frequency + offset_y, z[i] * frequency + offset_z
        (cell_x, ix), (cell_y, iy), (cell_z, iz) = nearest(px), nearest(py), nearest(pz)
        fractions[i], fractions[i + ROW], fractions[i + 2 * ROW] = px - cell_x, py - cell_y, pz - cell_z
        words[i], words[i + ROW] = ix, ix >> np.uint64(32)
        words[i + 2 * ROW], words[i + 3 * ROW] = iy, iy >> np.uint64(32)
        words[i + 4 * ROW], words[i + 5 * ROW] = iz, iz >> np.uint64(32)


@inlined
def axis_hashes(
    low: np.uint32, high: np.uint32, up: np.uint32, axis: np.uint32, key: np.uint32
) -> tuple[np.uint32, np.uint32]:
    """Return the hashes of coordinate i + up and of i + up + 1, where i has words `low` and `high` and up < 2**31."""
    word = np.uint32(low + up)
    carry = np.uint32((low & ~word) >> np.uint32(31))
    first = np.uint32(np.uint32(word * axis) + np.uint32(np.uint32(np.uint32(high + carry) * PAGE) + key))
    turns = choose(word == LAST_WORD, PAGE, HERE)
    return stir(first, ROUND_1), stir(np.uint32(np.uint32(first + axis) + turns), ROUND_1)


@inlined
def stir(bits: np.uint32, multiplier: np.uint32) -> np.uint32:
    """Return `bits` with the high half folded onto the low one and multiplied up again: the top bits depend on all."""
    return np.uint32((bits ^ (bits >> np.uint32(16))) * multiplier)


@inlined
def flip(value: np.float32, bits: np.uint32) -> np.float32:
    """Return `value` with its sign flipped if the top bit is set."""
    flipped: Any = np.uint32(np.float32(value).view(np.uint32) ^ (bits & _SIGN))
    return np.float32(flipped.view(np.float32))


@inlined
def unit(bits: np.uint32) -> np.float32:
    """Return the bits as a number in [-1, 1], evenly spread."""
    return np.float32(np.float32(np.int32(bits)) * _TO_UNIT)
