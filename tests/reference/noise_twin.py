"""Noises in plain Python, one point at a time: what the compiled ones must give, bit for bit.

Numbers are numpy scalars, so every step rounds where its type says. Nothing is shared with `chunkserver.field.noise`
but the constants.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from chunkserver.field.noise import cellular, gradient, lattice, simplex

f32 = np.float32
MASK_32 = (1 << 32) - 1
MASK_64 = (1 << 64) - 1
EXPONENT = 0x4338 << 48
"""The bits of 1.5 * 2**52: they stay in each integer that is split off a coordinate."""
AXES = [int(lattice.AXIS_X), int(lattice.AXIS_Y), int(lattice.AXIS_Z)]

Point = dict[int, np.float64]
"""Coordinates by axis: 2-D noises leave out axis 1."""


def stir(bits: int, multiplier: np.uint32) -> int:
    return (bits ^ bits >> 16) * int(multiplier) & MASK_32


def axis_hash(i: int, axis: int, key: int) -> int:
    """Hash one lattice coordinate, a two's complement integer of any size."""
    low, high = i & MASK_32, (i & MASK_64) >> 32
    return stir(low * AXES[axis] + high * int(lattice.PAGE) + key & MASK_32, lattice.ROUND_1)


def corner_hash(corner: dict[int, int], keys: Sequence[int]) -> int:
    """Hash a lattice point, given as {axis: coordinate}."""
    total = sum(axis_hash(i, axis, keys[axis]) for axis, i in corner.items())
    return stir(total & MASK_32, lattice.ROUND_2)


def split(x: np.float64) -> tuple[int, np.float64]:
    whole = np.rint(x)
    return int(whole), x - whole


def flip(value: np.float32, sign: int) -> np.float32:
    return -value if sign else value


def signed(bits: int) -> int:
    return bits - (1 << 32) if bits >> 31 else bits


def unit(bits: int) -> np.float32:
    return f32(signed(bits)) * f32(2.0**-31)


def third(bits: int) -> int:
    choice = signed(bits << 2 & MASK_32)
    return 0 if choice < -(2**32 // 6) else 2 if choice > 2**32 // 6 else 1


def quintic(t: np.float32) -> np.float32:
    return t * t * t * (t * (t * f32(6) - f32(15)) + f32(10))


def dot2(bits: int, away: Sequence[np.float32]) -> np.float32:
    steep, swap = bits >> 29 & 1, bits >> 28 & 1
    long, short = reversed(away) if swap else away
    a = (gradient.COS_3 if steep else gradient.COS_1) * long
    b = (gradient.SIN_3 if steep else gradient.SIN_1) * short
    return flip(a, bits >> 31) + flip(b, bits >> 30 & 1)


def dot3(bits: int, away: Sequence[np.float32]) -> np.float32:
    dx, dy, dz = away
    u, v = ((dy, dz), (dx, dy), (dz, dx))[third(bits)]
    return flip(u, bits >> 31) + flip(gradient.PHI * v, bits >> 30 & 1)


def edge_slope(bits: int, away: Sequence[np.float32]) -> np.float32:
    u, v = [step for axis, step in enumerate(away) if axis != third(bits)]
    return flip(u, bits >> 31) + flip(v, bits >> 30 & 1)


def blended(point: Point, keys: Sequence[int], value: Callable[[int, Sequence[np.float32]], np.float32]) -> np.float32:
    """Blend value(hash, way from the corner) of the corners of the point's cell, along x first, along z last."""
    parts = {axis: split(coordinate) for axis, coordinate in point.items()}

    def blend(axes: Sequence[int], up: dict[int, int]) -> np.float32:
        if not axes:
            bits = corner_hash({axis: parts[axis][0] + step + EXPONENT for axis, step in up.items()}, keys)
            return value(bits, [f32(parts[axis][1]) + f32(0.5 - up[axis]) for axis in point])
        *inner, axis = axes
        low, high = (blend(inner, {axis: step, **up}) for step in (0, 1))
        return low + quintic(f32(parts[axis][1]) + f32(0.5)) * (high - low)

    return blend(list(point), {})


def gradient2(x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return gradient.GRADIENT2_SCALE * blended({0: x, 2: z}, keys, dot2)


def gradient3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return gradient.GRADIENT3_SCALE * blended({0: x, 1: y, 2: z}, keys, dot3)


def value2(x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return blended({0: x, 2: z}, keys, lambda bits, _: unit(bits))


def value3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return blended({0: x, 1: y, 2: z}, keys, lambda bits, _: unit(bits))


def simplex2(x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    (cell_x, part_x), (cell_z, part_z) = split(x), split(z)
    total = cell_x + cell_z
    q = int(np.rint(np.float64(total) * (1 / 11)))
    fx, fz, rest = f32(part_x), f32(part_z), f32(total - 11 * q)

    skew = ((fx + fz) + rest) * f32(4 / 11)
    ax, az = (np.rint((part + skew) - f32(0.5)) for part in (fx, fz))
    unskew = ((ax + az) + rest) * f32(4 / 19)
    dx, dz = (fx - ax) + unskew, (fz - az) + unskew

    low_x, low_z = (cell + 4 * q + int(a) + 5 * EXPONENT for cell, a in ((cell_x, ax), (cell_z, az)))
    value = f32(0)
    for steps, (up_x, up_z) in enumerate([(0, 0), (1, 0) if dx >= dz else (0, 1), (1, 1)]):
        away = dx + f32(4 / 19 * steps - up_x), dz + f32(4 / 19 * steps - up_z)
        bits = corner_hash({0: low_x + up_x, 2: low_z + up_z}, keys)
        value += kernel(away[0] * away[0] + away[1] * away[1]) * dot2(bits, away)
    return value * simplex.SIMPLEX2_SCALE


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
        away = [d[i] + f32(step / 6 - walked[i]) for i in range(3)]
        bits = corner_hash({i: corner[i] + walked[i] for i in range(3)}, keys)
        value += kernel((away[0] * away[0] + away[1] * away[1]) + away[2] * away[2]) * edge_slope(bits, away)
    return value * simplex.SIMPLEX3_SCALE


def largest_first(d: list[np.float32]) -> list[int]:
    """Return the axes, that of the largest coordinate first; of equal ones x before y before z."""
    return sorted(range(3), key=lambda axis: -d[axis])


def kernel(square: np.float32) -> np.float32:
    left = max(simplex.REACH - square, f32(0))
    return (left * left) * (left * left)


def cellular2(
    x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int], jitter: float, what: int
) -> np.float32:
    return nearest_points({0: x, 2: z}, keys, jitter, what)


def cellular3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int], jitter: float, what: int) -> np.float32:
    return nearest_points({0: x, 1: y, 2: z}, keys, jitter, what)


def nearest_points(point: Point, keys: Sequence[int], jitter: float, what: int) -> np.float32:
    """Return what cellular noise returns at a point."""
    parts = {axis: split(coordinate) for axis, coordinate in point.items()}
    found: list[tuple[np.float32, int, int]] = []
    for steps in itertools.product((-1, 0, 1), repeat=len(point)):
        cell = {axis: parts[axis][0] + step + EXPONENT for axis, step in zip(point, steps, strict=True)}
        bits = corner_hash(cell, keys)
        square = f32(0)
        for axis, step, shift in zip(point, steps, shifts(bits), strict=False):
            away = (f32(step) - f32(parts[axis][1])) + f32(jitter) * f32(2.0**-16) * f32(shift)
            square = square + away * away
        found.append((square, len(found), bits))
    (first, _, bits), (second, _, _), *_ = sorted(found)
    near, far = (f32(np.sqrt(min(square, f32(1)))) for square in (first, second))
    return {
        cellular.DISTANCE: near,
        cellular.EDGE: far - near,
        cellular.VALUE: unit(stir(stir(bits, lattice.ROUND_1), lattice.ROUND_2)),
    }[what]


def shifts(bits: int) -> list[int]:
    """Return where a cell's feature point lies along each axis, -2**15 to 2**15 - 1."""
    more = stir(bits, lattice.ROUND_1)
    return [signed(word) >> 16 for word in (bits, more, more << 16 & MASK_32)]
