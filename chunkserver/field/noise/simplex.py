"""Simplex noise: a random gradient at each corner of a lattice of triangles or tetrahedra, each in a round kernel.

Source: K. Perlin, "Noise hardware" (2001). How the skew is split without big numbers is ours.
"""

from typing import Final

import numpy as np

from chunkserver.field.noise.gradient import dot2
from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BLOCK,
    FIRST_THIRD,
    HALF,
    LAST_THIRD,
    ROUND_2,
    ZERO,
    Doubles,
    Floats,
    Words,
    axis_hashes,
    flip,
    floor32,
    nearest,
    stir,
)
from chunkserver.kernel import inlined, kernel

REACH: Final = np.float32(0.5)
"""Squared radius of a corner's kernel: the largest that ends inside the simplices around it, so there is no step."""
SIMPLEX3_SCALE: Final = np.float32(76.8)
"""Brings 3-D simplex noise into [-1, 1]: its supremum is 1/76.88, found by a search over points and gradients."""

_THIRD: Final = np.float32(1 / 3)
_SIXTH: Final = np.float32(1 / 6)
_STEP_1: Final = np.float32(1 / 6 - 1)
_STEP_2: Final = np.float32(1 / 3 - 1)
SIMPLEX2_SCALE: Final = np.float32(99.5)
"""Brings 2-D simplex noise into [-1, 1] in the same way: its supremum is 1/99.609."""

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
            fx, fz, rest = fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK]
            skew = np.float32(np.float32(np.float32(fx + fz) + rest) * SKEW)
            ax, az = floor32(np.float32(fx + skew)), floor32(np.float32(fz + skew))
            unskew = np.float32(np.float32(np.float32(ax + az) + rest) * UNSKEW)
            up_x, up_z = np.uint32(np.int32(ax + _UP)), np.uint32(np.int32(az + _UP))
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], up_x, AXIS_X, key_x)
            z0, z1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], up_z, AXIS_Z, key_z)
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
        fractions[i], fractions[i + BLOCK] = px - cell_x, pz - cell_z
        fractions[i + 2 * BLOCK] = total - 11.0 * q
        ix, iz = ix + (iq << np.uint64(2)) - _BELOW, iz + (iq << np.uint64(2)) - _BELOW
        words[i], words[i + BLOCK] = ix, ix >> np.uint64(32)
        words[i + 2 * BLOCK], words[i + 3 * BLOCK] = iz, iz >> np.uint64(32)


@inlined
def _simplex2(dx: np.float32, dz: np.float32, x0: np.uint32, x1: np.uint32, z0: np.uint32, z1: np.uint32) -> np.float32:
    """Return simplex noise at (dx, dz) from the low corner of a square with these hashes per axis, low and high."""
    x_first = dx >= dz
    middle = np.uint32((x1 if x_first else x0) + (z0 if x_first else z1))
    value = _corner2(np.uint32(x0 + z0), dx, dz)
    value += _corner2(
        middle,
        np.float32(dx + (_STEP_X if x_first else UNSKEW)),
        np.float32(dz + (UNSKEW if x_first else _STEP_X)),
    )
    value += _corner2(np.uint32(x1 + z1), np.float32(dx + _STEP_XZ), np.float32(dz + _STEP_XZ))
    return np.float32(value * SIMPLEX2_SCALE)


@inlined
def _corner2(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    """Return one corner's kernel times its gradient, one of the sixteen of gradient noise."""
    return _times_kernel(np.float32(np.float32(dx * dx) + np.float32(dz * dz)), dot2(sum_of_axes, dx, dz))


@inlined
def _times_kernel(square: np.float32, slope: np.float32) -> np.float32:
    """Return a corner's slope, times (REACH - squared distance)^4 or 0 where that is negative."""
    left = np.float32(REACH - square)
    left = left if left > ZERO else ZERO
    left = np.float32(left * left)
    return np.float32(np.float32(left * left) * slope)


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
) -> None:
    """Write below + amplitude * simplex noise in [-1, 1], mean 0. Arguments: `chunkserver.field.noise`.

    Space is skewed along its diagonal, p -> p + sum(p)/3, so that cubes fall into six tetrahedra each. With p split
    into cell c and fraction f, and sum(c) = 3q + r, the skew is q + (r + sum f)/3: any whole q near sum(c)/3 leaves
    small numbers only. The low corner of the point's cube is c + q + a, where a = floor(f + (r + sum f)/3); unskewed
    it lies at c + a - (r + sum a)/6, from which q is gone. q is taken two too low: then a is 0 to 3, never negative.
    """
    amplitude, key_x, key_y, key_z = np.float32(numbers[0]), keys[0], keys[1], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        _split_simplex3(x[start:stop], y[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            fx, fy, fz = fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK]
            ax, ay, az, dx, dy, dz = _simplex_cell(fx, fy, fz, fractions[i + 3 * BLOCK])
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], ax, AXIS_X, key_x)
            y0, y1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], ay, AXIS_Y, key_y)
            z0, z1 = axis_hashes(words[i + 4 * BLOCK], words[i + 5 * BLOCK], az, AXIS_Z, key_z)
            noise = _simplex3(dx, dy, dz, x0, x1, y0, y1, z0, z1)
            outs[i] = belows[i] + np.float32(amplitude * noise)


@kernel
def _split_simplex3(x: Doubles, y: Doubles, z: Doubles, numbers: Doubles, fractions: Floats, words: Words) -> None:
    """Split coordinates of up to BLOCK points: f, r in rows of fractions, the words of c + q in rows of words."""
    frequency, offset_x, offset_y, offset_z = numbers[1], numbers[2], numbers[3], numbers[4]
    for i in range(x.size):
        px, py, pz = x[i] * frequency + offset_x, y[i] * frequency + offset_y, z[i] * frequency + offset_z
        (cell_x, ix), (cell_y, iy), (cell_z, iz) = nearest(px), nearest(py), nearest(pz)
        total = cell_x + cell_y + cell_z
        q, iq = nearest(total * (1 / 3) - 2.0)
        fractions[i], fractions[i + BLOCK], fractions[i + 2 * BLOCK] = px - cell_x, py - cell_y, pz - cell_z
        fractions[i + 3 * BLOCK] = total - 3.0 * q
        ix, iy, iz = ix + iq, iy + iq, iz + iq
        words[i], words[i + BLOCK] = ix, ix >> np.uint64(32)
        words[i + 2 * BLOCK], words[i + 3 * BLOCK] = iy, iy >> np.uint64(32)
        words[i + 4 * BLOCK], words[i + 5 * BLOCK] = iz, iz >> np.uint64(32)


@inlined
def _simplex_cell(
    fx: np.float32, fy: np.float32, fz: np.float32, rest: np.float32
) -> tuple[np.uint32, np.uint32, np.uint32, np.float32, np.float32, np.float32]:
    """Return a, the low corner of the point's skewed cube, and the point relative to that corner, unskewed."""
    skew = np.float32(np.float32(np.float32(fx + fy) + np.float32(fz + rest)) * _THIRD)
    ax, ay, az = floor32(np.float32(fx + skew)), floor32(np.float32(fy + skew)), floor32(np.float32(fz + skew))
    unskew = np.float32(np.float32(np.float32(ax + ay) + np.float32(az + rest)) * _SIXTH)
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
    value = _corner3(np.uint32(x0 + y0 + z0), dx, dy, dz)
    value += _corner3(
        corner_1,
        np.float32(dx + (_STEP_1 if sx else _SIXTH)),
        np.float32(dy + (_STEP_1 if sy else _SIXTH)),
        np.float32(dz + (_STEP_1 if sz else _SIXTH)),
    )
    value += _corner3(
        corner_2,
        np.float32(dx + (_STEP_2 if tx else _THIRD)),
        np.float32(dy + (_STEP_2 if ty else _THIRD)),
        np.float32(dz + (_STEP_2 if tz else _THIRD)),
    )
    value += _corner3(np.uint32(x1 + y1 + z1), np.float32(dx - HALF), np.float32(dy - HALF), np.float32(dz - HALF))
    return np.float32(value * SIMPLEX3_SCALE)


@inlined
def _corner3(sum_of_axes: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    """Return one corner's kernel times its gradient, one of the twelve (+-1, +-1, 0) and their permutations."""
    bits = stir(sum_of_axes, ROUND_2)
    # Two bits are the signs; the rest, as a signed number, falls into one of three thirds and names the axis left out.
    third = np.int32(np.uint32(bits << np.uint32(2)))
    u = dy if third < FIRST_THIRD else dx
    v = dy if third > LAST_THIRD else dz
    slope = np.float32(flip(u, bits) + flip(v, np.uint32(bits << np.uint32(1))))
    square = np.float32(np.float32(np.float32(dx * dx) + np.float32(dy * dy)) + np.float32(dz * dz))
    return _times_kernel(square, slope)
