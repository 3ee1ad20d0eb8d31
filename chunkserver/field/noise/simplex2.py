"""Simplex noise of the plane: a random gradient at each corner of a lattice of triangles, each in a round kernel.

Source: K. Perlin, "Noise hardware" (2001). How the skew is split without big numbers is ours.
"""

from typing import Final

import numpy as np

from chunkserver.field.noise.gradient import dot2
from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Z,
    BLOCK,
    ROW,
    ZERO,
    Doubles,
    Floats,
    Words,
    axis_hashes,
    floor32,
    nearest,
)
from chunkserver.kernel import choose, inlined, kernel

REACH: Final = np.float32(0.5)
"""Squared radius of a corner's kernel: the largest that ends inside the simplices around it, so there is no step."""
SIMPLEX2_SCALE: Final = np.float32(99.5)
"""Brings 2-D simplex noise into [-1, 1]: its supremum is 1/99.609, found by a search over points and gradients."""

SKEW: Final = np.float32(4 / 11)
UNSKEW: Final = np.float32(4 / 19)
"""The 2-D skew and its way back. Equilateral triangles want (sqrt(3) - 1)/2, 0.7 % more, which cannot be split into
whole numbers. With 4/11 the squared edges are as 241 to 242, and the kernels still end inside the triangles."""
_BELOW: Final = np.uint64(4)
_UP: Final = np.float32(4)
_STEP_X: Final = np.float32(4 / 19 - 1)
_STEP_XZ: Final = np.float32(8 / 19 - 1)


@kernel
def add_simplex2(
    x: Doubles,
    y: Doubles,  # noqa: ARG001 - all noises have one signature
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
    width: int,  # noqa: ARG001 - all noises have one signature
) -> None:
    """Write below + amplitude * 2-D simplex noise in [-1, 1], mean 0. Arguments: see the package.

    The plane is skewed along its diagonal, p -> p + sum(p) * 4/11, so that squares fall into two triangles each. With
    p split into cell c and fraction f, and sum(c) = 11q + r, the skew is 4q + (r + sum f) * 4/11. The low corner of the
    point's square is c + 4q + a, where a = floor(f + (r + sum f) * 4/11); unskewed it lies at
    c + a - (r + sum a) * 4/19, from which q is gone. a is -4 to 3; hashes count from 4 below, to stay positive.
    """
    amplitude, key_x, key_z = np.float32(numbers[0]), keys[0], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        _split_simplex2(x[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            fx, fz, rest = fractions[i], fractions[i + ROW], fractions[i + 2 * ROW]
            skew = np.float32(np.float32(np.float32(fx + fz) + rest) * SKEW)
            ax, az = floor32(np.float32(fx + skew)), floor32(np.float32(fz + skew))
            unskew = np.float32(np.float32(np.float32(ax + az) + rest) * UNSKEW)
            up_x, up_z = np.uint32(np.int32(ax + _UP)), np.uint32(np.int32(az + _UP))
            x0, x1 = axis_hashes(words[i], words[i + ROW], up_x, AXIS_X, key_x)
            z0, z1 = axis_hashes(words[i + 2 * ROW], words[i + 3 * ROW], up_z, AXIS_Z, key_z)
            noise = _simplex2(np.float32(fx - ax) + unskew, np.float32(fz - az) + unskew, x0, x1, z0, z1)
            outs[i] = belows[i] + np.float32(amplitude * noise)


@kernel
def _split_simplex2(x: Doubles, z: Doubles, numbers: Doubles, fractions: Floats, words: Words) -> None:
    """Split coordinates of up to BLOCK points: f, r in rows of fractions, the words of c + 4q - 4 in rows of words."""
    frequency, offset_x, offset_z = numbers[1], numbers[2], numbers[4]
    for i in range(x.size):
        px, pz = x[i] * frequency + offset_x, z[i] * frequency + offset_z
        (cell_x, ix), (cell_z, iz) = nearest(px), nearest(pz)
        total = cell_x + cell_z
        q, iq = nearest(total * (1 / 11))
        fractions[i], fractions[i + ROW] = px - cell_x, pz - cell_z
        fractions[i + 2 * ROW] = total - 11.0 * q
        ix, iz = ix + (iq << np.uint64(2)) - _BELOW, iz + (iq << np.uint64(2)) - _BELOW
        words[i], words[i + ROW] = ix, ix >> np.uint64(32)
        words[i + 2 * ROW], words[i + 3 * ROW] = iz, iz >> np.uint64(32)


@inlined
def _simplex2(dx: np.float32, dz: np.float32, x0: np.uint32, x1: np.uint32, z0: np.uint32, z1: np.uint32) -> np.float32:
    """Return simplex noise at (dx, dz) from the low corner of a square with these hashes per axis, low and high."""
    x_first = dx >= dz
    middle = np.uint32(choose(x_first, x1, x0) + choose(x_first, z0, z1))
    value = _corner2(np.uint32(x0 + z0), dx, dz)
    value += _corner2(
        middle,
        np.float32(dx + choose(x_first, _STEP_X, UNSKEW)),
        np.float32(dz + choose(x_first, UNSKEW, _STEP_X)),
    )
    value += _corner2(np.uint32(x1 + z1), np.float32(dx + _STEP_XZ), np.float32(dz + _STEP_XZ))
    return np.float32(value * SIMPLEX2_SCALE)


@inlined
def _corner2(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return one corner's kernel times its gradient, one of the sixteen of gradient noise."""
    square = np.float32(np.float32(dx * dx) + np.float32(dz * dz))
    return times_kernel(np.float32(REACH - square), dot2(sum_of_axes, dx, dz))


@inlined
def times_kernel(left: np.float32, slope: np.float32) -> np.float32:
    """Return a corner's slope, times left^4, or 0 where that is negative.

    left: REACH - squared distance.
    """
    left = choose(left > ZERO, left, ZERO)
    left = np.float32(left * left)
    return np.float32(np.float32(left * left) * slope)
