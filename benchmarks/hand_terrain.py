"""`terrain` at LOD 0 as one function written by hand: what a tape is measured against.

The same bits as the recipe's (`tests/bench/test_by_hand.py`), and nothing of the field's code but how a noise is named.
Written as one would for this field alone:

- What depends on one axis (lattice cells, fractions, blends) is worked out once per axis, not once per sample. Inside
  of a chunk cells are small whole numbers, so the loop over samples has no 64-bit number in it.
- A row is padded to whole vectors. What is written beyond its end, the next row overwrites.
- Ground and caves meet in a register: no array of either is ever written but for the ground's columns.

It skips nothing: every sample is worked out.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.noise.names import noise_name
from chunkserver.grid import ChunkKey
from chunkserver.kernel import inlined, kernel

SIDE: Final = 35
"""Samples of 32 cells, apron included."""
ROW: Final = 40
"""SIDE, padded to vectors of eight."""
OCTAVES: Final = 5
AMPLITUDES: Final = tuple(np.float32(0.5**i / math.fsum(0.5**j for j in range(OCTAVES))) for i in range(OCTAVES))

_AXIS_X, _AXIS_Y, _AXIS_Z, _PAGE = (np.uint32(math.isqrt(n << 64) & 0xFFFFFFFF | 1) for n in (2, 3, 5, 7))
_ROUND_1, _ROUND_2 = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_SIGN, _THIRD_OF_HASHES = np.uint32(1 << 31), np.int32(2**32 // 6)
_ROUNDER, _ROUNDER_32 = 1.5 * 2.0**52, np.float32(1.5 * 2.0**23)
_ZERO, _HALF, _THIRD, _SIXTH = np.float32(0), np.float32(0.5), np.float32(1 / 3), np.float32(1 / 6)
_STEP_1, _STEP_2 = np.float32(1 / 6 - 1), np.float32(1 / 3 - 1)
_COS_1, _SIN_1 = (np.float32(math.sqrt(2 + sign * math.sqrt(2 + math.sqrt(2))) / 2) for sign in (1, -1))
_COS_3, _SIN_3 = (np.float32(math.sqrt(2 + sign * math.sqrt(2 - math.sqrt(2))) / 2) for sign in (1, -1))
_SCALE_2, _SCALE_3, _LIMIT = np.float32(1.437), np.float32(76.8), np.float32(65536)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]


def terrain(seed: int) -> Callable[[ChunkKey], NDArray[np.float32]]:
    """Return the field of a world: key (LOD 0, 32 cells) -> density (35, 35, 35) float32, as `Samples` has it."""
    names = [noise_name(seed, 0, number) for number in range(OCTAVES + 1)]  # 0: the caves; then the octaves
    frequencies = [0.05, *(0.02 * 2.0**octave for octave in range(OCTAVES))]
    numbers = np.array([(frequency, *name[0]) for frequency, name in zip(frequencies, names, strict=True)])
    keys = np.array([name[1] for name in names], np.uint32)

    def field(key: ChunkKey) -> NDArray[np.float32]:
        low = np.array(key.low_corner(SIDE - 3), np.float64) - 1.0
        density = np.empty(SIDE**3 + ROW - SIDE, np.float32)
        _fill(low, numbers, keys, density)
        return density[: SIDE**3].reshape(SIDE, SIDE, SIDE)

    return field


@kernel
def _fill(low: _Doubles, numbers: _Doubles, keys: _Words, density: _Floats) -> None:
    """Write the chunk whose first sample is at `low` (x, y, z). caves first.

    numbers: (6, 4), of each noise the frequency and the offsets of x, y, z. keys: (6, 3).
    """
    height = np.zeros((SIDE, ROW), np.float32)
    for octave in range(OCTAVES):
        _add_octave(low, numbers[octave + 1], keys[octave + 1], AMPLITUDES[octave], height)
    fractions, steps, origins = np.empty((3, ROW), np.float32), np.empty((3, ROW), np.uint32), np.empty(3, np.int64)
    for axis in range(3):
        origins[axis] = _split(low[axis], numbers[0], axis, fractions[axis], steps[axis])
    third = (origins[0] + origins[1] + origins[2]) // 3
    rest = np.uint32(origins[0] + origins[1] + origins[2] - 3 * third)
    starts, turns = np.empty(3, np.uint32), np.empty(3, np.uint32)
    for axis in range(3):
        multiplier = _AXIS_X if axis == 0 else _AXIS_Y if axis == 1 else _AXIS_Z
        _start_hash(origins[axis] + third - 2, 2, multiplier, keys[0, axis], starts[axis:], turns[axis:])
    xs = fractions[0], steps[0]
    for y in range(SIDE):
        at_y = np.float32(low[1] + y)
        for z in range(SIDE):
            row = density[(y * SIDE + z) * SIDE : (y * SIDE + z) * SIDE + ROW]
            yz = fractions[1, y], fractions[2, z], steps[1, y], steps[2, z]
            _fill_row(at_y, height[z], xs, yz, rest, starts, turns, row)


@inlined
def _split(low: float, numbers: _Doubles, axis: int, fractions: _Floats, steps: _Words) -> int:
    """Split one axis' coordinates: fractions from the nearest cell, steps up from the first cell, which it returns."""
    first = low * numbers[0] + numbers[1 + axis]
    origin = np.int64(np.float64(first + _ROUNDER) - _ROUNDER)
    for i in range(fractions.size):
        place = (low + i) * numbers[0] + numbers[1 + axis]
        cell = np.float64(place + _ROUNDER) - _ROUNDER
        fractions[i], steps[i] = np.float32(place - cell), np.uint32(np.int64(cell) - origin)
    return int(origin)


@inlined
def _start_hash(
    coordinate: int, exponents: int, multiplier: np.uint32, key: np.uint32, starts: _Words, turns: _Words
) -> None:
    """Write the hash input of a whole coordinate, and how many steps up from it its low word stays without a carry.

    exponents: of how many rounded floats the coordinate's bits are the sum; that shifts what is hashed.
    """
    bits = np.uint64(coordinate) + np.uint64(exponents) * np.float64(_ROUNDER).view(np.uint64)
    low, high = np.uint32(bits), np.uint32(bits >> np.uint64(32))
    starts[0] = np.uint32(np.uint32(low * multiplier) + np.uint32(np.uint32(high * _PAGE) + key))
    turns[0] = ~low


@inlined
def _hashes(up: np.uint32, start: np.uint32, turn: np.uint32, axis: np.uint32) -> tuple[np.uint32, np.uint32]:
    """Return the hashes of the coordinates `up` and `up` + 1 steps from the one that `start` was made of."""
    first = np.uint32(start + np.uint32(up * axis))
    carry, next_carry = _PAGE if up > turn else np.uint32(0), _PAGE if up >= turn else np.uint32(0)
    return _stir(np.uint32(first + carry), _ROUND_1), _stir(np.uint32(first + axis + next_carry), _ROUND_1)


@inlined
def _stir(bits: np.uint32, multiplier: np.uint32) -> np.uint32:
    return np.uint32((bits ^ (bits >> np.uint32(16))) * multiplier)


@inlined
def _flip(value: np.float32, bits: np.uint32) -> np.float32:
    flipped: Any = np.uint32(np.float32(value).view(np.uint32) ^ (bits & _SIGN))
    return np.float32(flipped.view(np.float32))


@inlined
def _add_octave(low: _Doubles, numbers: _Doubles, keys: _Words, amplitude: np.float32, height: _Floats) -> None:
    """Add amplitude * 2-D gradient noise to height (SIDE, ROW)."""
    fractions, steps = np.empty((2, ROW), np.float32), np.empty((2, ROW), np.uint32)
    starts, turns = np.empty(2, np.uint32), np.empty(2, np.uint32)
    _start_hash(_split(low[0], numbers, 0, fractions[0], steps[0]), 1, _AXIS_X, keys[0], starts, turns)
    _start_hash(_split(low[2], numbers, 2, fractions[1], steps[1]), 1, _AXIS_Z, keys[2], starts[1:], turns[1:])
    firsts, nexts, blends = np.empty(ROW, np.uint32), np.empty(ROW, np.uint32), np.empty(ROW, np.float32)
    for i in range(ROW):
        firsts[i], nexts[i] = _hashes(steps[0, i], starts[0], turns[0], _AXIS_X)
        blends[i] = _quintic(np.float32(fractions[0, i] + _HALF))
    for z in range(SIDE):
        z0, z1 = _hashes(steps[1, z], starts[1], turns[1], _AXIS_Z)
        near, far = np.float32(fractions[1, z] + _HALF), np.float32(fractions[1, z] - _HALF)
        blend_z = _quintic(near)
        for i in range(ROW):
            left, right = np.float32(fractions[0, i] + _HALF), np.float32(fractions[0, i] - _HALF)
            x0, x1, blend = firsts[i], nexts[i], blends[i]
            below = _mix(_dot(np.uint32(x0 + z0), left, near), _dot(np.uint32(x1 + z0), right, near), blend)
            above = _mix(_dot(np.uint32(x0 + z1), left, far), _dot(np.uint32(x1 + z1), right, far), blend)
            height[z, i] += np.float32(amplitude * np.float32(_SCALE_2 * _mix(below, above, blend_z)))


@inlined
def _quintic(t: np.float32) -> np.float32:
    inner = np.float32(t * np.float32(np.float32(t * np.float32(6)) - np.float32(15)) + np.float32(10))
    return np.float32(np.float32(np.float32(t * t) * t) * inner)


@inlined
def _mix(low: np.float32, high: np.float32, share: np.float32) -> np.float32:
    return np.float32(low + np.float32(share * np.float32(high - low)))


@inlined
def _dot(sum_of_axes: np.uint32, dx: np.float32, dz: np.float32) -> np.float32:
    bits = _stir(sum_of_axes, _ROUND_2)
    steep, swap = bits & np.uint32(1 << 29), bits & np.uint32(1 << 28)
    long = np.float32((_COS_3 if steep else _COS_1) * (dz if swap else dx))
    short = np.float32((_SIN_3 if steep else _SIN_1) * (dx if swap else dz))
    return np.float32(_flip(long, bits) + _flip(short, np.uint32(bits << np.uint32(1))))


@inlined
def _fill_row(
    at_y: np.float32,
    height: _Floats,
    xs: tuple[_Floats, _Words],
    yz: tuple[np.float32, np.float32, np.uint32, np.uint32],
    rest: np.uint32,
    starts: _Words,
    turns: _Words,
    row: _Floats,
) -> None:
    """Write one row: the larger of the ground and of the caves, which are simplex noise.

    With t = rest + the steps on all axes, the sum of a sample's cell is 3 * third + t, and the nearest whole number to
    a third of it, less two, is third - 2 + (t + 1) // 3.
    """
    fractions, steps = xs
    fy, fz, step_y, step_z = yz
    start_x, start_y, start_z = starts[0], starts[1], starts[2]
    turn_x, turn_y, turn_z = turns[0], turns[1], turns[2]
    for i in range(ROW):
        fx, total = fractions[i], np.uint32(rest + steps[i] + step_y + step_z)
        third = np.uint32(np.uint32(np.uint32(total + np.uint32(1)) * np.uint32(43691)) >> np.uint32(17))
        left = np.float32(np.int32(total) - np.int32(np.uint32(third * np.uint32(3))) + np.int32(6))
        skew = np.float32(np.float32(np.float32(fx + fy) + np.float32(fz + left)) * _THIRD)
        ax, ay, az = _floor(np.float32(fx + skew)), _floor(np.float32(fy + skew)), _floor(np.float32(fz + skew))
        unskew = np.float32(np.float32(np.float32(ax + ay) + np.float32(az + left)) * _SIXTH)
        dx, dy, dz = np.float32(fx - ax) + unskew, np.float32(fy - ay) + unskew, np.float32(fz - az) + unskew
        x0, x1 = _hashes(np.uint32(steps[i] + third + np.uint32(np.int32(ax))), start_x, turn_x, _AXIS_X)
        y0, y1 = _hashes(np.uint32(step_y + third + np.uint32(np.int32(ay))), start_y, turn_y, _AXIS_Y)
        z0, z1 = _hashes(np.uint32(step_z + third + np.uint32(np.int32(az))), start_z, turn_z, _AXIS_Z)
        cave = np.float32(_simplex(dx, dy, dz, x0, x1, y0, y1, z0, z1) - np.float32(0.6)) * np.float32(6)
        ground = np.float32(at_y - np.float32(height[i] * np.float32(24)))
        value = ground if ground > cave else cave
        value = value if value > -_LIMIT else -_LIMIT
        row[i] = value if value < _LIMIT else _LIMIT


@inlined
def _floor(x: np.float32) -> np.float32:
    return np.float32(np.float32(np.float32(x - _HALF) + _ROUNDER_32) - _ROUNDER_32)


@inlined
def _simplex(
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
    x_over_y, y_over_z, x_over_z = dx >= dy, dy >= dz, dx >= dz
    sx, sy, sz = x_over_y & x_over_z, (not x_over_y) & y_over_z, not (x_over_z | y_over_z)
    tx, ty, tz = x_over_y | x_over_z, (not x_over_y) | y_over_z, not (x_over_z & y_over_z)
    value = _corner(np.uint32(x0 + y0 + z0), dx, dy, dz)
    value += _corner(
        np.uint32((x1 if sx else x0) + (y1 if sy else y0) + (z1 if sz else z0)),
        np.float32(dx + (_STEP_1 if sx else _SIXTH)),
        np.float32(dy + (_STEP_1 if sy else _SIXTH)),
        np.float32(dz + (_STEP_1 if sz else _SIXTH)),
    )
    value += _corner(
        np.uint32((x1 if tx else x0) + (y1 if ty else y0) + (z1 if tz else z0)),
        np.float32(dx + (_STEP_2 if tx else _THIRD)),
        np.float32(dy + (_STEP_2 if ty else _THIRD)),
        np.float32(dz + (_STEP_2 if tz else _THIRD)),
    )
    value += _corner(np.uint32(x1 + y1 + z1), np.float32(dx - _HALF), np.float32(dy - _HALF), np.float32(dz - _HALF))
    return np.float32(value * _SCALE_3)


@inlined
def _corner(sum_of_axes: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32) -> np.float32:
    bits = _stir(sum_of_axes, _ROUND_2)
    third = np.int32(np.uint32(bits << np.uint32(2)))
    u = dy if third < -_THIRD_OF_HASHES else dx
    v = dy if third > _THIRD_OF_HASHES else dz
    slope = np.float32(_flip(u, bits) + _flip(v, np.uint32(bits << np.uint32(1))))
    near = np.float32(_HALF - np.float32(np.float32(np.float32(dx * dx) + np.float32(dy * dy)) + np.float32(dz * dz)))
    near = near if near > _ZERO else _ZERO
    near = np.float32(near * near)
    return np.float32(np.float32(near * near) * slope)
