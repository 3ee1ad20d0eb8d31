"""Gradient noise (Perlin): a random gradient at each lattice corner, blended over the square or cube between them.

A cell is the unit square or cube around a whole number, so corners lie half-way between whole numbers.

Source: K. Perlin, "Improving Noise" (2002): the quintic blend. The gradients are ours.
"""

import math
from typing import Final

import numpy as np

from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BLOCK,
    FIRST_THIRD,
    HALF,
    HERE,
    LAST_THIRD,
    ROUND_2,
    Doubles,
    Floats,
    Words,
    axis_hashes,
    flip,
    mix,
    quintic,
    split2,
    split3,
    stir,
)
from chunkserver.kernel import inlined, kernel

GRADIENT2_SCALE: Final = np.float32(1.437)
"""Brings 2-D gradient noise with the gradients below into [-1, 1]: its supremum is 1/1.4381, found by a search over
points and gradients."""

# Sixteen unit gradients, 22.5 degrees apart, none along an axis or a diagonal: at 11.25 and 33.75 degrees and their
# reflections. By half-angle formulas, since sqrt is exact and cos need not be.
COS_1: Final = np.float32(math.sqrt(2 + math.sqrt(2 + math.sqrt(2))) / 2)
SIN_1: Final = np.float32(math.sqrt(2 - math.sqrt(2 + math.sqrt(2))) / 2)
COS_3: Final = np.float32(math.sqrt(2 + math.sqrt(2 - math.sqrt(2))) / 2)
SIN_3: Final = np.float32(math.sqrt(2 - math.sqrt(2 - math.sqrt(2))) / 2)

GRADIENT3_SCALE: Final = np.float32(0.7315)
"""Brings 3-D gradient noise into [-1, 1] in the same way: with the gradients below its supremum is 1/0.73201."""

# The twelve corners of an icosahedron: (0, +-1, +-PHI) and its cyclic permutations. The mean of any polynomial of
# degree 5 or less over them is its mean over the sphere: no direction is preferred up to that order. Over the middles
# of a cube's edges, the usual choice, the mean of x^4 is 2 times that of x^2 y^2, where the sphere's is 3 times.
PHI: Final = np.float32((1 + math.sqrt(5)) / 2)


@kernel
def add_gradient2(
    x: Doubles,
    y: Doubles,  # noqa: ARG001 - all noises have one signature
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
) -> None:
    """Write below + amplitude * gradient noise in [-1, 1], 0 on the lattice, mean 0. Arguments: see the package."""
    amplitude, key_x, key_z = np.float32(numbers[0]), keys[0], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        split2(x[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], HERE, AXIS_X, key_x)
            z0, z1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], HERE, AXIS_Z, key_z)
            noise = _gradient2(fractions[i], fractions[i + BLOCK], x0, x1, z0, z1)
            outs[i] = belows[i] + np.float32(amplitude * noise)


@inlined
def _gradient2(
    fx: np.float32, fz: np.float32, x0: np.uint32, x1: np.uint32, z0: np.uint32, z1: np.uint32
) -> np.float32:
    """Return gradient noise at (fx, fz) from the middle of a cell whose corners have these hashes per axis."""
    left, right = np.float32(fx + HALF), np.float32(fx - HALF)
    near, far = np.float32(fz + HALF), np.float32(fz - HALF)
    blend_x = quintic(left)
    low = mix(dot2(np.uint32(x0 + z0), left, near), dot2(np.uint32(x1 + z0), right, near), blend_x)
    high = mix(dot2(np.uint32(x0 + z1), left, far), dot2(np.uint32(x1 + z1), right, far), blend_x)
    return np.float32(GRADIENT2_SCALE * mix(low, high, quintic(near)))


@inlined
def dot2(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of one of sixteen unit gradients with (dx, dz)."""
    bits = stir(sum_of_axes, ROUND_2)
    steep, swap = bits & np.uint32(1 << 29), bits & np.uint32(1 << 28)
    long = np.float32((COS_3 if steep else COS_1) * (dz if swap else dx))
    short = np.float32((SIN_3 if steep else SIN_1) * (dx if swap else dz))
    return np.float32(flip(long, bits) + flip(short, np.uint32(bits << np.uint32(1))))


@kernel
def add_gradient3(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
) -> None:
    """Write below + amplitude * 3-D gradient noise in [-1, 1], 0 at corners, mean 0. Arguments: see the package."""
    amplitude, key_x, key_y, key_z = np.float32(numbers[0]), keys[0], keys[1], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        split3(x[start:stop], y[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            fx, fy, fz = fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK]
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], HERE, AXIS_X, key_x)
            y0, y1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], HERE, AXIS_Y, key_y)
            z0, z1 = axis_hashes(words[i + 4 * BLOCK], words[i + 5 * BLOCK], HERE, AXIS_Z, key_z)
            low = _face(fx, fy, np.float32(fz + HALF), x0, x1, y0, y1, z0)
            high = _face(fx, fy, np.float32(fz - HALF), x0, x1, y0, y1, z1)
            noise = np.float32(GRADIENT3_SCALE * mix(low, high, quintic(np.float32(fz + HALF))))
            outs[i] = belows[i] + np.float32(amplitude * noise)


@inlined
def _face(
    fx: np.float32,
    fy: np.float32,
    dz: np.float32,
    x0: np.uint32,
    x1: np.uint32,
    y0: np.uint32,
    y1: np.uint32,
    hash_z: np.uint32,
) -> np.float32:
    """Return the blend of the four corners of a cell's face across z, dz away."""
    left, right = np.float32(fx + HALF), np.float32(fx - HALF)
    below, above = np.float32(fy + HALF), np.float32(fy - HALF)
    low, high, blend_x = np.uint32(y0 + hash_z), np.uint32(y1 + hash_z), quintic(left)
    return mix(
        mix(_dot3(np.uint32(x0 + low), left, below, dz), _dot3(np.uint32(x1 + low), right, below, dz), blend_x),
        mix(_dot3(np.uint32(x0 + high), left, above, dz), _dot3(np.uint32(x1 + high), right, above, dz), blend_x),
        quintic(below),
    )


@inlined
def _dot3(sum_of_axes: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Return the dot product of one of the twelve gradients with (dx, dy, dz)."""
    bits = stir(sum_of_axes, ROUND_2)
    # Two bits are the signs; the rest, as a signed number, falls into one of three thirds and names the permutation.
    third = np.int32(np.uint32(bits << np.uint32(2)))
    first, last = third < FIRST_THIRD, third > LAST_THIRD
    u = dy if first else (dz if last else dx)
    v = dz if first else (dx if last else dy)
    return np.float32(flip(u, bits) + flip(np.float32(PHI * v), np.uint32(bits << np.uint32(1))))
