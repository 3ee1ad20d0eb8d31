"""Simplex noise in space: a random gradient at each corner of a lattice of tetrahedra, each in a round kernel.

The lattice is that of whole numbers and, half a cell away along every axis, a second one like it: the centred cubes
that classical simplex noise has too, there turned so that the cubes stand on their corners. Here they stand straight.
So what a corner is made of, but for a sum, is known axis by axis: nothing is skewed, and what depends on one axis, or
on y and z, is worked out once where points come in rows.

A point's tetrahedron has two corners of each lattice: the nearest one, and the next one along the axis on which the
point is farthest from that. No other corner is nearer than sqrt(REACH).

Source: K. Perlin, "Noise hardware" (2001): gradients in round kernels. The walk over the lattice is ours.

Scratch rows of BLOCK numbers, for each axis and of each lattice:

    AT, FAR         how far the point is from the nearer corner and, on the other side, from the farther one
    SIDE            2 |AT| - 1: by how much the squared distance shrinks with a step to the farther one
    SQUARE          AT squared
    BITS, FAR_BITS  their hashes

`_join` makes one of y and z: for a step along the one of them on which the point is farther off, or along x.
"""

from typing import Final

import numpy as np

from chunkserver.field.noise.lattice import (
    AXES,
    BLOCK,
    FIRST_THIRD,
    HALF,
    HERE,
    LAST_THIRD,
    LAST_WORD,
    ONE,
    PAGE,
    ROUND_1,
    ROUND_2,
    ROW,
    ROW_LEAST,
    ZERO,
    Doubles,
    Floats,
    Words,
    flip,
    split,
    stir,
    whole_vectors,
)
from chunkserver.field.noise.simplex2 import REACH, times_kernel
from chunkserver.kernel import aligned_stack, choose, inlined, kernel

SIMPLEX3_SCALE: Final = np.float32(76.8)
"""Brings 3-D simplex noise into [-1, 1]: its supremum is 1/76.88, found by a search over points and gradients."""

_TWO: Final = np.float32(2)

_FAR: Final = ROW
_SIDE: Final = 2 * ROW
_SQUARE: Final = 3 * ROW
_OTHER: Final = 4 * ROW
"""From a row of the first lattice to that of the second."""
_Y: Final = 8 * ROW
_Z: Final = 16 * ROW
_SUM: Final = 24 * ROW

_FAR_BITS: Final = ROW
_OTHER_WORDS: Final = 2 * ROW
_Y_WORDS: Final = 4 * ROW
_Z_WORDS: Final = 8 * ROW


@kernel
def add_simplex3(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
    width: int,
) -> None:
    """Write below + amplitude * simplex noise in [-1, 1], mean 0. Arguments: `chunkserver.field.noise`."""
    in_rows = ROW_LEAST <= width <= BLOCK
    step = width if in_rows else 1
    for start in range(0, out.size, BLOCK * step):
        n = min(BLOCK, (out.size - start) // step)
        across = min(whole_vectors(width), x.size - start) if in_rows else n
        _read_axes(x, y, z, start, across, step, n, numbers, keys, fractions, words)
        _join(n, fractions, words)
        if in_rows:
            _rows(start, width, across, n, fractions, words, out)
        else:
            _points(start, n, fractions, words, out)
    _put(np.float32(numbers[0]), below, out)


@inlined
def _read_axes(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    start: int,
    across: int,
    step: int,
    n: int,
    numbers: Doubles,
    keys: Words,
    fractions: Floats,
    words: Words,
) -> None:
    """Write the rows of each axis: of `across` points along x; and of n in y and z, `step` from one to the next."""
    for axis in range(3):
        place = x if axis == 0 else (y if axis == 1 else z)
        stride, count = (1, across) if axis == 0 else (step, n)
        own_fractions, own_words = fractions[_Y * axis :], words[_Y_WORDS * axis :]
        split(axis, place, start, stride, count, numbers, own_fractions, own_words)
        _finish_axis(AXES[axis], keys[axis], count, own_fractions, own_words)


@inlined
def _finish_axis(multiplier: np.uint32, key: np.uint32, n: int, fractions: Floats, words: Words) -> None:
    """Turn the rows that a split writes into an axis' own. The second lattice's corners have the number below them."""
    for i in range(n):
        at, low = fractions[i], words[i]
        inner = np.uint32(np.uint32(low * multiplier) + np.uint32(np.uint32(words[i + ROW] * PAGE) + key))
        outer_low = np.uint32(inner - multiplier) - choose(low == HERE, PAGE, HERE)
        outer_high = np.uint32(inner + multiplier) + choose(low == LAST_WORD, PAGE, HERE)
        here, lower = stir(inner, ROUND_1), stir(np.uint32(outer_low), ROUND_1)
        higher = stir(np.uint32(outer_high), ROUND_1)
        up = at >= ZERO
        step = choose(up, ONE, -ONE)
        other = np.float32(at - np.float32(HALF * step))
        fractions[i + _FAR], fractions[i + _OTHER + _FAR] = at - step, other + step
        fractions[i + _SIDE], fractions[i + _OTHER + _SIDE] = _side(at), _side(other)
        fractions[i + _SQUARE], fractions[i + _OTHER + _SQUARE] = at * at, other * other
        fractions[i + _OTHER] = other
        words[i], words[i + _FAR_BITS] = here, choose(up, higher, lower)
        words[i + _OTHER_WORDS] = choose(up, here, lower)
        words[i + _OTHER_WORDS + _FAR_BITS] = choose(up, lower, here)


@inlined
def _side(at: np.float32) -> np.float32:
    return np.float32(_TWO * np.float32(abs(at))) - ONE


@inlined
def _join(n: int, fractions: Floats, words: Words) -> None:
    """Turn the rows of y and of z into those of both: SQUARE into what both leave of REACH."""
    for other in range(2):
        y, z = fractions[_Y + other * _OTHER :], fractions[_Z + other * _OTHER :]
        y_words, z_words = words[_Y_WORDS + other * _OTHER_WORDS :], words[_Z_WORDS + other * _OTHER_WORDS :]
        for i in range(n):
            side_y, side_z = y[i + _SIDE], z[i + _SIDE]
            along_y = side_y >= side_z
            y[i + _SQUARE] = REACH - np.float32(y[i + _SQUARE] + z[i + _SQUARE])
            y[i + _SIDE] = choose(along_y, side_y, side_z)
            y[i + _FAR], z[i + _FAR] = choose(along_y, y[i + _FAR], y[i]), choose(along_y, z[i], z[i + _FAR])
            bits_y, bits_z = y_words[i], z_words[i]
            far_y, far_z = np.uint32(y_words[i + _FAR_BITS] + bits_z), np.uint32(bits_y + z_words[i + _FAR_BITS])
            y_words[i], y_words[i + _FAR_BITS] = np.uint32(bits_y + bits_z), choose(along_y, far_y, far_z)


@inlined
def _rows(start: int, width: int, across: int, rows: int, fractions: Floats, words: Words, out: Floats) -> None:
    """Write the sums of rows of `width` points. What x makes of them is there for `across`, in whole vectors.

    What is written beyond a row's end, the next row overwrites. rows: at most BLOCK, which the loop says once more, for
    without it indices might be negative.
    """
    aligned_stack()
    multipliers = (ROUND_2, ROUND_1)
    for row in range(min(rows, BLOCK)):
        for other in range(2):
            x, word = other * _OTHER, other * _OTHER_WORDS
            y, z, yz = _Y + x + row, _Z + x + row, _Y_WORDS + word + row
            near_y, near_z, far_y, far_z = fractions[y], fractions[z], fractions[y + _FAR], fractions[z + _FAR]
            side, left, bits, far_bits = fractions[y + _SIDE], fractions[y + _SQUARE], words[yz], words[yz + _FAR_BITS]
            for i in range(min(across, BLOCK)):
                at, bits_x = x + i, word + i
                pair = _two_corners(
                    fractions[at],
                    fractions[at + _FAR],
                    fractions[at + _SIDE],
                    fractions[at + _SQUARE],
                    words[bits_x],
                    words[bits_x + _FAR_BITS],
                    near_y,
                    near_z,
                    far_y,
                    far_z,
                    side,
                    left,
                    bits,
                    far_bits,
                    multipliers[other],
                )
                fractions[i + _SUM] = pair + (fractions[i + _SUM] if other else ZERO)
        sums = out[start + row * width :]
        for i in range(min(across, sums.size)):
            sums[i] = fractions[i + _SUM]


@inlined
def _points(start: int, n: int, fractions: Floats, words: Words, out: Floats) -> None:
    """Write the sums of n points, each with an x, y and z of its own."""
    multipliers, sums = (ROUND_2, ROUND_1), out[start:]
    for other in range(2):
        x, word = other * _OTHER, other * _OTHER_WORDS
        for i in range(n):
            y, z, yz = _Y + x + i, _Z + x + i, _Y_WORDS + word + i
            at, bits_x = x + i, word + i
            pair = _two_corners(
                fractions[at],
                fractions[at + _FAR],
                fractions[at + _SIDE],
                fractions[at + _SQUARE],
                words[bits_x],
                words[bits_x + _FAR_BITS],
                fractions[y],
                fractions[z],
                fractions[y + _FAR],
                fractions[z + _FAR],
                fractions[y + _SIDE],
                fractions[y + _SQUARE],
                words[yz],
                words[yz + _FAR_BITS],
                multipliers[other],
            )
            sums[i] = pair + (sums[i] if other else ZERO)


@inlined
def _put(amplitude: np.float32, below: Floats, out: Floats) -> None:
    """Turn sums of four corners into what is asked for."""
    for i in range(out.size):
        out[i] = below[i] + np.float32(amplitude * np.float32(SIMPLEX3_SCALE * out[i]))


@inlined
def _two_corners(
    x: np.float32,
    far_x: np.float32,
    side_x: np.float32,
    square: np.float32,
    bits_x: np.uint32,
    far_bits_x: np.uint32,
    y: np.float32,
    z: np.float32,
    far_y: np.float32,
    far_z: np.float32,
    side: np.float32,
    left: np.float32,
    bits: np.uint32,
    far_bits: np.uint32,
    multiplier: np.uint32,
) -> np.float32:
    """Return what the two corners of one lattice make of a point, from its rows of x and those of y and z."""
    along_x = side_x >= side
    left = np.float32(left - square)
    first = times_kernel(left, _slope(stir(np.uint32(bits_x + bits), multiplier), x, y, z))
    x, y, z = choose(along_x, far_x, x), choose(along_x, y, far_y), choose(along_x, z, far_z)
    left = np.float32(left + choose(along_x, side_x, side))
    bits = choose(along_x, np.uint32(far_bits_x + bits), np.uint32(bits_x + far_bits))
    return np.float32(first + times_kernel(left, _slope(stir(bits, multiplier), x, y, z)))


@inlined
def _slope(bits: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of (dx, dy, dz) with one of the twelve gradients (+-1, +-1, 0) and their permutations."""
    # Two bits are the signs; the rest, as a signed number, falls into one of three thirds and names the axis left out.
    third = np.int32(np.uint32(bits << np.uint32(2)))
    u = choose(third < FIRST_THIRD, dy, dx)
    v = choose(third > LAST_THIRD, dy, dz)
    return np.float32(flip(u, bits) + flip(v, np.uint32(bits << np.uint32(1))))
