"""Noises in plain Python, one point at a time: what the compiled ones must give, bit for bit.

Numbers are numpy scalars, so every step rounds where its type says. Nothing is shared with `chunkserver.field.noise`
but the constants.
"""

from collections.abc import Sequence

import numpy as np

from chunkserver.field.noise import gradient, lattice, simplex

f32 = np.float32
MASK_32 = (1 << 32) - 1
MASK_64 = (1 << 64) - 1
EXPONENT = 0x4338 << 48
"""The bits of 1.5 * 2**52: they stay in each integer that is split off a coordinate."""
AXES = [int(lattice.AXIS_X), int(lattice.AXIS_Y), int(lattice.AXIS_Z)]


def stir(bits: int, multiplier: np.uint32) -> int:
    return (bits ^ bits >> 16) * int(multiplier) & MASK_32


def axis_hash(i: int, axis: int, key: int) -> int:
    """Hash one lattice coordinate, a two's complement integer of any size."""
    low, high = i & MASK_32, (i & MASK_64) >> 32
    return stir(low * AXES[axis] + high * int(lattice.PAGE) + key & MASK_32, lattice.ROUND_1)


def corner_hash(corner: dict[int, int], keys: Sequence[int]) -> int:
    """Hash a lattice corner, given as {axis: coordinate}."""
    total = sum(axis_hash(i, axis, keys[axis]) for axis, i in corner.items())
    return stir(total & MASK_32, lattice.ROUND_2)


def split(x: np.float64) -> tuple[int, np.float64]:
    whole = np.rint(x)
    return int(whole), x - whole


def flip(value: np.float32, sign: int) -> np.float32:
    return -value if sign else value


def dot2(bits: int, dx: np.float32, dz: np.float32) -> np.float32:
    steep, swap = bits >> 29 & 1, bits >> 28 & 1
    long, short = (dz, dx) if swap else (dx, dz)
    a = (gradient.COS_3 if steep else gradient.COS_1) * long
    b = (gradient.SIN_3 if steep else gradient.SIN_1) * short
    return flip(a, bits >> 31) + flip(b, bits >> 30 & 1)


def gradient2(x: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    (ix, fx), (iz, fz) = split(x), split(z)
    value = {}
    for a in (0, 1):
        for b in (0, 1):
            bits = corner_hash({0: ix + a + EXPONENT, 2: iz + b + EXPONENT}, keys)
            value[a, b] = dot2(bits, f32(fx) + f32(0.5 - a), f32(fz) + f32(0.5 - b))
    blend_x, blend_z = quintic(f32(fx) + f32(0.5)), quintic(f32(fz) + f32(0.5))
    low = value[0, 0] + blend_x * (value[1, 0] - value[0, 0])
    high = value[0, 1] + blend_x * (value[1, 1] - value[0, 1])
    return gradient.GRADIENT2_SCALE * (low + blend_z * (high - low))


def quintic(t: np.float32) -> np.float32:
    return t * t * t * (t * (t * f32(6) - f32(15)) + f32(10))


def simplex3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    cells, parts = zip(*(split(c) for c in (x, y, z)), strict=True)
    total = sum(cells)
    q = int(np.rint(np.float64(total) * (1 / 3) - 2))
    f, rest = [f32(part) for part in parts], f32(total - 3 * q)

    skew = ((f[0] + f[1]) + (f[2] + rest)) * f32(1 / 3)
    a = [np.rint((part + skew) - f32(0.5)) for part in f]
    unskew = ((a[0] + a[1]) + (a[2] + rest)) * f32(1 / 6)
    d = [(part - low) + unskew for part, low in zip(f, a, strict=True)]

    corner = [cell + q + int(low) + 2 * EXPONENT for cell, low in zip(cells, a, strict=True)]
    value, walked = f32(0), [0, 0, 0]
    for step, axis in enumerate([None, *largest_first(d)]):
        if axis is not None:
            walked[axis] = 1
        offset = [d[i] + f32(step / 6 - walked[i]) for i in range(3)]
        bits = corner_hash({i: corner[i] + walked[i] for i in range(3)}, keys)
        value += simplex_corner(bits, *offset)
    return value * simplex.SIMPLEX3_SCALE


def largest_first(d: list[np.float32]) -> list[int]:
    """Return the axes, that of the largest coordinate first; of equal ones x before y before z."""
    return sorted(range(3), key=lambda axis: -d[axis])


def simplex_corner(bits: int, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    choice = bits << 2 & MASK_32
    signed = choice - (1 << 32) if choice >> 31 else choice
    u = dy if signed < -(2**32 // 6) else dx
    v = dy if signed > 2**32 // 6 else dz
    left = max(simplex.REACH - ((dx * dx + dy * dy) + dz * dz), f32(0))
    return (left * left) * (left * left) * (flip(u, bits >> 31) + flip(v, bits >> 30 & 1))
