"""Noises in plain Python, one point at a time: what the compiled ones must give, bit for bit.

Numbers are numpy scalars, so every step rounds where its type says. Nothing is shared with `chunkserver.field.noise`
but the constants.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from chunkserver.field.noise import cellular, gradient, lattice
from chunkserver.field.noise import simplex2 as plane
from chunkserver.field.noise import simplex3 as space

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


def compass(bits: int) -> list[np.float32]:
    """Return the x and z of one of sixteen unit gradients."""
    long, short = (gradient.COS_3, gradient.SIN_3) if bits >> 29 & 1 else (gradient.COS_1, gradient.SIN_1)
    pair = [flip(long, bits >> 31), flip(short, bits >> 30 & 1)]
    return pair[::-1] if bits >> 28 & 1 else pair


def icosahedron(bits: int) -> list[np.float32]:
    """Return the x, y and z of one of twelve gradients."""
    u, v, zero = flip(f32(1), bits >> 31), flip(gradient.PHI, bits >> 30 & 1), f32(0)
    return [[zero, u, v], [u, v, zero], [v, zero, u]][third(bits)]


def dot2(bits: int, away: Sequence[np.float32]) -> np.float32:
    x, z = compass(bits)
    return x * away[0] + z * away[1]


def edge_slope(bits: int, away: Sequence[np.float32]) -> np.float32:
    u, v = [step for axis, step in enumerate(away) if axis != third(bits)]
    return flip(u, bits >> 31) + flip(v, bits >> 30 & 1)


def mix(low: np.float32, high: np.float32, share: np.float32) -> np.float32:
    return low + share * (high - low)


def corners(point: Point, keys: Sequence[int]) -> tuple[dict[tuple[int, ...], int], dict[int, np.float32]]:
    """Return the hash of each corner of the point's cell, by its steps up, and where in the cell the point lies."""
    parts = {axis: split(coordinate) for axis, coordinate in point.items()}
    found = {}
    for up in itertools.product((0, 1), repeat=len(point)):
        corner = {axis: parts[axis][0] + step + EXPONENT for axis, step in zip(point, up, strict=True)}
        found[up] = corner_hash(corner, keys)
    return found, {axis: f32(part) for axis, (_, part) in parts.items()}


def gradient2(x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    """Blend along x what is left of each line along it, a value and a slope along z; then along z."""
    hashes, at = corners({0: x, 2: z}, keys)
    lines = []
    for up_z in (0, 1):
        (x0, z0), (x1, z1) = (compass(hashes[up_x, up_z]) for up_x in (0, 1))
        blend = quintic(at[0] + f32(0.5))
        lines.append((mix(x0 * (at[0] + f32(0.5)), x1 * (at[0] - f32(0.5)), blend), mix(z0, z1, blend)))
    return gradient.GRADIENT2_SCALE * between(lines, at[2])


def gradient3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    """Blend along y, then as in the plane."""
    hashes, at = corners({0: x, 1: y, 2: z}, keys)
    below, above = at[1] + f32(0.5), at[1] - f32(0.5)
    lines = []
    for up_z in (0, 1):
        edges = []
        for up_x in (0, 1):
            (x0, y0, z0), (x1, y1, z1) = (icosahedron(hashes[up_x, up_y, up_z]) for up_y in (0, 1))
            along_x = mix(x0, x1, quintic(below)) * (at[0] + f32(0.5 - up_x))
            edges.append((mix(y0 * below, y1 * above, quintic(below)) + along_x, mix(z0, z1, quintic(below))))
        lines.append([mix(low, high, quintic(at[0] + f32(0.5))) for low, high in zip(*edges, strict=True)])
    return gradient.GRADIENT3_SCALE * between(lines, at[2])


def between(lines: Sequence[Sequence[np.float32]], at: np.float32) -> np.float32:
    """Return what two lines, a value and a slope each, make of a point at `at` from the middle between them."""
    near, far = at + f32(0.5), at - f32(0.5)
    return mix(lines[0][0] + lines[0][1] * near, lines[1][0] + lines[1][1] * far, quintic(near))


def blended(point: Point, keys: Sequence[int]) -> np.float32:
    """Blend the random numbers of the corners of the point's cell, along x first, along z last."""
    hashes, at = corners(point, keys)
    values = {up: unit(bits) for up, bits in hashes.items()}
    for axis in at:
        share = quintic(at[axis] + f32(0.5))
        values = {up[1:]: mix(low, values[1, *up[1:]], share) for up, low in values.items() if up[0] == 0}
    return values[()]


def value2(x: np.float64, _y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return blended({0: x, 2: z}, keys)


def value3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    return blended({0: x, 1: y, 2: z}, keys)


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
        value += kernel(plane.REACH - (away[0] * away[0] + away[1] * away[1])) * dot2(bits, away)
    return value * plane.SIMPLEX2_SCALE


def simplex3(x: np.float64, y: np.float64, z: np.float64, keys: Sequence[int]) -> np.float32:
    """Add up what the two lattices make, each of its nearest corner and of the next one along one axis."""
    cells, parts = zip(*(split(c) for c in (x, y, z)), strict=True)
    at = [f32(part) for part in parts]
    up = [1 if part >= 0 else -1 for part in at]
    whole = [(cell, cell + step) for cell, step in zip(cells, up, strict=True)]
    halves = [(cell, cell - 1) if step > 0 else (cell - 1, cell) for cell, step in zip(cells, up, strict=True)]
    other = [part - f32(step / 2) for part, step in zip(at, up, strict=True)]
    ways = [part - f32(step) for part, step in zip(at, up, strict=True)]
    other_ways = [part + f32(step) for part, step in zip(other, up, strict=True)]
    value = two_corners(whole, at, ways, keys, lattice.ROUND_2) + f32(0)
    value = two_corners(halves, other, other_ways, keys, lattice.ROUND_1) + value
    return space.SIMPLEX3_SCALE * value


def two_corners(
    corner: list[tuple[int, int]],
    near: list[np.float32],
    far: list[np.float32],
    keys: Sequence[int],
    multiplier: np.uint32,
) -> np.float32:
    """Return what a lattice's nearest corner and the next one make.

    corner: by axis, the numbers of the nearer and the farther one. near, far: the ways from them.
    """
    side = [f32(2) * abs(part) - f32(1) for part in near]
    across = max(side[1], side[2])
    axis = 0 if side[0] >= across else 1 if side[1] >= side[2] else 2
    left = plane.REACH - (near[1] * near[1] + near[2] * near[2]) - near[0] * near[0]
    value = f32(0)
    for turned in (False, True):
        step = [int(turned and i == axis) for i in range(3)]
        away = [(near[i], far[i])[step[i]] for i in range(3)]
        total = sum(axis_hash(corner[i][step[i]] + EXPONENT, i, keys[i]) for i in range(3))
        value += kernel(left + max(side[0], across) if turned else left) * edge_slope(
            stir(total & MASK_32, multiplier), away
        )
    return value


def kernel(left: np.float32) -> np.float32:
    """Return left^4, or 0 where it is negative. left: the squared radius, less the squared distance."""
    left = max(left, f32(0))
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
