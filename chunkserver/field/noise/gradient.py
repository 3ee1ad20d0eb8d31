"""Gradient noise (Perlin): a random gradient at each lattice corner, blended over the square or cube between them.

A cell is the unit square or cube around a whole number, so corners lie half-way between whole numbers.

A gradient's part along z is blended apart from the rest, so that it is multiplied with the way along z once, last: all
else is the same for all points with the same x and y that lie between the same two planes of corners.

Source: K. Perlin, "Improving Noise" (2002): the quintic blend. The gradients are ours.
"""

import math
from typing import Final

import numpy as np

from chunkserver.field.noise.lattice import (
    FIRST_THIRD,
    HALF,
    LAST_THIRD,
    ONE,
    ROUND_2,
    ROW,
    ZERO,
    Floats,
    Words,
    flip,
    stir,
)
from chunkserver.field.noise.lines import HIGH, LINE_Y, LOW, X_AT, X_BLEND, X_HIGH, X_LOW, mix
from chunkserver.kernel import choose, inlined, kernel

GRADIENT2_SCALE: Final = np.float32(1.437)
"""Brings 2-D gradient noise with the gradients below into [-1, 1]: its supremum is 1/1.4381, found by a search over
points and gradients."""

# Sixteen unit gradients, 22.5 degrees apart, none along an axis or a diagonal: at 11.25 and 33.75 degrees and their
# reflections. By half-angle formulas, since sqrt is exact and cos need not be.
COS_1: Final = np.float32(math.sqrt(2 + math.sqrt(2 + math.sqrt(2))) / 2)
SIN_1: Final = np.float32(math.sqrt(2 - math.sqrt(2 + math.sqrt(2))) / 2)
COS_3: Final = np.float32(math.sqrt(2 + math.sqrt(2 - math.sqrt(2))) / 2)
SIN_3: Final = np.float32(math.sqrt(2 - math.sqrt(2 - math.sqrt(2))) / 2)

_STEEP: Final = np.uint32(1 << 29)
_SWAP: Final = np.uint32(1 << 28)
"""The bits of a hash that choose among them, beside two signs."""

GRADIENT3_SCALE: Final = np.float32(0.7315)
"""Brings 3-D gradient noise into [-1, 1] in the same way: with the gradients below its supremum is 1/0.73201."""

# The twelve corners of an icosahedron: (0, +-1, +-PHI) and its cyclic permutations. The mean of any polynomial of
# degree 5 or less over them is its mean over the sphere: no direction is preferred up to that order. Over the middles
# of a cube's edges, the usual choice, the mean of x^4 is 2 times that of x^2 y^2, where the sphere's is 3 times.
PHI: Final = np.float32((1 + math.sqrt(5)) / 2)


@inlined
def compass(bits: np.uint32) -> tuple[np.float32, np.float32]:
    """Return the x and z of the one of sixteen unit gradients that a corner's hash picks."""
    # Compared as 32-bit numbers: Numba takes `if bits & mask` for a comparison of 64-bit ones, at half the width.
    steep, swap = np.uint32(bits & _STEEP) == _STEEP, np.uint32(bits & _SWAP) == _SWAP
    long = flip(choose(steep, COS_3, COS_1), bits)
    short = flip(choose(steep, SIN_3, SIN_1), np.uint32(bits << np.uint32(1)))
    return choose(swap, short, long), choose(swap, long, short)


@inlined
def icosahedron(bits: np.uint32) -> tuple[np.float32, np.float32, np.float32]:
    """Return the x, y and z of the one of twelve gradients that a corner's hash picks."""
    # Two bits are the signs; the rest, as a signed number, falls into one of three thirds and names the permutation.
    third = np.int32(np.uint32(bits << np.uint32(2)))
    first, last = third < FIRST_THIRD, third > LAST_THIRD
    u, v = flip(ONE, bits), flip(PHI, np.uint32(bits << np.uint32(1)))
    return (
        choose(first, ZERO, choose(last, v, u)),
        choose(first, u, choose(last, ZERO, v)),
        choose(first, v, choose(last, u, ZERO)),
    )


@kernel
def gradient_line2(n: int, fractions: Floats, words: Words, into: int) -> None:
    """Write a line, as `lines` defines it, of gradient noise of the plane."""
    line = fractions[into:]
    for i in range(n):
        left, right = np.float32(fractions[i + X_AT] + HALF), np.float32(fractions[i + X_AT] - HALF)
        blend = fractions[i + X_BLEND]
        x0, z0 = compass(stir(np.uint32(words[i + X_LOW] + words[i + LOW]), ROUND_2))
        x1, z1 = compass(stir(np.uint32(words[i + X_HIGH] + words[i + LOW]), ROUND_2))
        line[i] = mix(np.float32(x0 * left), np.float32(x1 * right), blend)
        line[i + ROW] = mix(z0, z1, blend)


@kernel
def gradient_line3(n: int, fractions: Floats, words: Words, into: int) -> None:
    """Write a line, as `lines` defines it, of gradient noise in space."""
    line, y = fractions[into:], fractions[LINE_Y:]
    for i in range(n):
        left, right = np.float32(fractions[i + X_AT] + HALF), np.float32(fractions[i + X_AT] - HALF)
        blend, y_blend, y_at = fractions[i + X_BLEND], y[i + ROW], y[i]
        low, high = words[i + LOW], words[i + HIGH]
        flat0, z0 = _edge(words[i + X_LOW], low, high, left, y_at, y_blend)
        flat1, z1 = _edge(words[i + X_HIGH], low, high, right, y_at, y_blend)
        line[i] = mix(flat0, flat1, blend)
        line[i + ROW] = mix(z0, z1, blend)


@inlined
def _edge(
    x: np.uint32, low: np.uint32, high: np.uint32, dx: np.float32, y_at: np.float32, blend: np.float32
) -> tuple[np.float32, np.float32]:
    """Blend along y: a corner's gradient times the way to it in x and y, and the gradient's z."""
    below, above = np.float32(y_at + HALF), np.float32(y_at - HALF)
    x0, y0, z0 = icosahedron(stir(np.uint32(x + low), ROUND_2))
    x1, y1, z1 = icosahedron(stir(np.uint32(x + high), ROUND_2))
    flat = np.float32(mix(x0, x1, blend) * dx)
    return np.float32(mix(np.float32(y0 * below), np.float32(y1 * above), blend) + flat), mix(z0, z1, blend)


@inlined
def dot2(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of one of sixteen unit gradients with (dx, dz)."""
    x, z = compass(stir(sum_of_axes, ROUND_2))
    return np.float32(np.float32(x * dx) + np.float32(z * dz))
