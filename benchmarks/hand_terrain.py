"""`terrain` at LOD 0 as one function written by hand: what a tape is measured against.

The same bits as the recipe's (`tests/bench/test_by_hand.py`), and nothing of the field's code but how a noise is named.
Written as one would for this field alone:

- What depends on one axis (fractions, hashes, blends) is worked out once per axis, and what depends on y and z once per
  row, so the loop over samples has no 64-bit number in it.
- The ground's noise is blended from lines along x, one for each lattice line that the columns lie between.
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
from chunkserver.kernel import choose, inlined, kernel

SIDE: Final = 35
"""Samples of 32 cells, apron included."""
ROW: Final = 40
"""SIDE, padded to vectors of eight."""
OCTAVES: Final = 5
AMPLITUDES: Final = tuple(np.float32(0.5**i / math.fsum(0.5**j for j in range(OCTAVES))) for i in range(OCTAVES))

_AXIS_X, _AXIS_Y, _AXIS_Z, _PAGE = (np.uint32(math.isqrt(n << 64) & 0xFFFFFFFF | 1) for n in (2, 3, 5, 7))
_ROUND_1, _ROUND_2 = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_SIGN, _THIRD_OF_HASHES = np.uint32(1 << 31), np.int32(2**32 // 6)
_ROUNDER = 1.5 * 2.0**52
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_AT, _FAR, _SIDE, _SQUARE = range(4)
_BITS, _FAR_BITS = range(2)
"""Rows of an axis, for each of the two lattices of simplex noise."""
_COS_1, _SIN_1 = (np.float32(math.sqrt(2 + sign * math.sqrt(2 + math.sqrt(2))) / 2) for sign in (1, -1))
_COS_3, _SIN_3 = (np.float32(math.sqrt(2 + sign * math.sqrt(2 - math.sqrt(2))) / 2) for sign in (1, -1))
_SCALE_2, _SCALE_3, _LIMIT = np.float32(1.437), np.float32(76.8), np.float32(65536)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]
_Pair = tuple[np.float32, np.float32]
_Across = tuple[_Pair, _Pair, np.float32, np.float32, tuple[np.uint32, np.uint32]]
"""Of a row, in one lattice: how far the nearest corner is along y and z, and the next one along y or z; by how much the
square of the distance shrinks to that; what y and z leave of the squared reach; what y and z add to the two hashes."""


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
    ways, bits = np.empty((3, 2, 4, ROW), np.float32), np.empty((3, 2, 2, ROW), np.uint32)
    for axis in range(3):
        multiplier = _AXIS_X if axis == 0 else _AXIS_Y if axis == 1 else _AXIS_Z
        _read_axis(low[axis], numbers[0, 0], numbers[0, 1 + axis], multiplier, keys[0, axis], ways[axis], bits[axis])
    for y in range(SIDE):
        at_y = np.float32(low[1] + y)
        for z in range(SIDE):
            first, second = _join(0, y, z, ways, bits), _join(1, y, z, ways, bits)
            row = density[(y * SIDE + z) * SIDE : (y * SIDE + z) * SIDE + ROW]
            _fill_row(at_y, height[z], ways[0], bits[0], first, second, row)


@inlined
def _split(place: float, frequency: float, offset: float) -> tuple[np.float32, int]:
    """Return how far a coordinate is from the nearest lattice cell, and that cell's number."""
    at = place * frequency + offset
    cell = np.float64(at + _ROUNDER) - _ROUNDER
    return np.float32(at - cell), int(cell)


@inlined
def _hash(cell: int, multiplier: np.uint32, key: np.uint32) -> np.uint32:
    """Hash a cell's number. It is hashed with the bits of the float that rounds: they are the same for all."""
    word = np.uint64(cell) + np.float64(_ROUNDER).view(np.uint64)
    low, high = np.uint32(word), np.uint32(word >> np.uint64(32))
    return _stir(np.uint32(np.uint32(low * multiplier) + np.uint32(np.uint32(high * _PAGE) + key)), _ROUND_1)


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
    ways, blends, bits = np.empty(ROW, np.float32), np.empty(ROW, np.float32), np.empty((2, ROW), np.uint32)
    for i in range(ROW):
        ways[i], cell = _split(low[0] + i, numbers[0], numbers[1])
        bits[0, i], bits[1, i] = _hash(cell, _AXIS_X, keys[0]), _hash(cell + 1, _AXIS_X, keys[0])
        blends[i] = _quintic(np.float32(ways[i] + _HALF))
    lines, last = np.empty((2, 2, ROW), np.float32), 1 << 62
    for z in range(SIDE):
        at, cell = _split(low[2] + z, numbers[0], numbers[3])
        if cell == last + 1:
            lines[0] = lines[1]
        elif cell != last:
            _make_line(_hash(cell, _AXIS_Z, keys[2]), ways, blends, bits, lines[0])
        if cell != last:
            _make_line(_hash(cell + 1, _AXIS_Z, keys[2]), ways, blends, bits, lines[1])
        last = cell
        near, far = np.float32(at + _HALF), np.float32(at - _HALF)
        blend = _quintic(near)
        for i in range(ROW):
            below = np.float32(lines[0, 0, i] + np.float32(lines[0, 1, i] * near))
            above = np.float32(lines[1, 0, i] + np.float32(lines[1, 1, i] * far))
            height[z, i] += np.float32(amplitude * np.float32(_SCALE_2 * _mix(below, above, blend)))


@inlined
def _make_line(across: np.uint32, ways: _Floats, blends: _Floats, bits: _Words, line: _Floats) -> None:
    """Write what a line of lattice corners makes of each column: a value, and a slope along z."""
    for i in range(ROW):
        x0, z0 = _gradient(np.uint32(bits[0, i] + across))
        x1, z1 = _gradient(np.uint32(bits[1, i] + across))
        left, right = np.float32(ways[i] + _HALF), np.float32(ways[i] - _HALF)
        line[0, i] = _mix(np.float32(x0 * left), np.float32(x1 * right), blends[i])
        line[1, i] = _mix(z0, z1, blends[i])


@inlined
def _gradient(sum_of_axes: np.uint32) -> tuple[np.float32, np.float32]:
    bits = _stir(sum_of_axes, _ROUND_2)
    steep = np.uint32(bits & np.uint32(1 << 29)) != np.uint32(0)
    swap = np.uint32(bits & np.uint32(1 << 28)) != np.uint32(0)
    long = _flip(choose(steep, _COS_3, _COS_1), bits)
    short = _flip(choose(steep, _SIN_3, _SIN_1), np.uint32(bits << np.uint32(1)))
    return choose(swap, short, long), choose(swap, long, short)


@inlined
def _quintic(t: np.float32) -> np.float32:
    inner = np.float32(t * np.float32(np.float32(t * np.float32(6)) - np.float32(15)) + np.float32(10))
    return np.float32(np.float32(np.float32(t * t) * t) * inner)


@inlined
def _mix(low: np.float32, high: np.float32, share: np.float32) -> np.float32:
    return np.float32(low + np.float32(share * np.float32(high - low)))


@inlined
def _read_axis(
    low: float, frequency: float, offset: float, multiplier: np.uint32, key: np.uint32, ways: _Floats, bits: _Words
) -> None:
    """Write what an axis' ROW coordinates make of both lattices: ways (2, 4, ROW), bits (2, 2, ROW)."""
    for i in range(ROW):
        at, cell = _split(low + i, frequency, offset)
        up = at >= _ZERO
        step = choose(up, _ONE, -_ONE)
        beside = cell + 1 if up else cell - 1
        below = cell if up else cell - 1
        above = cell - 1 if up else cell
        half = np.float32(at - np.float32(_HALF * step))
        _write_axis(i, at, np.float32(at - step), cell, beside, multiplier, key, ways[0], bits[0])
        _write_axis(i, half, np.float32(half + step), below, above, multiplier, key, ways[1], bits[1])


@inlined
def _write_axis(
    i: int,
    at: np.float32,
    far: np.float32,
    cell: int,
    far_cell: int,
    multiplier: np.uint32,
    key: np.uint32,
    ways: _Floats,
    bits: _Words,
) -> None:
    ways[_AT, i], ways[_FAR, i] = at, far
    ways[_SIDE, i], ways[_SQUARE, i] = np.float32(np.float32(_TWO * np.float32(abs(at))) - _ONE), np.float32(at * at)
    bits[_BITS, i], bits[_FAR_BITS, i] = _hash(cell, multiplier, key), _hash(far_cell, multiplier, key)


@inlined
def _join(lattice: int, y: int, z: int, ways: _Floats, bits: _Words) -> _Across:
    """Return what y and z make of a row, in one lattice: see `_Across`."""
    ys, zs, y_bits, z_bits = ways[1, lattice], ways[2, lattice], bits[1, lattice], bits[2, lattice]
    along_y = ys[_SIDE, y] >= zs[_SIDE, z]
    hashes = (
        np.uint32(y_bits[_BITS, y] + z_bits[_BITS, z]),
        np.uint32(y_bits[_FAR_BITS, y] + z_bits[_BITS, z])
        if along_y
        else np.uint32(y_bits[_BITS, y] + z_bits[_FAR_BITS, z]),
    )
    return (
        (ys[_AT, y], zs[_AT, z]),
        (ys[_FAR, y] if along_y else ys[_AT, y], zs[_AT, z] if along_y else zs[_FAR, z]),
        ys[_SIDE, y] if along_y else zs[_SIDE, z],
        np.float32(_HALF - np.float32(ys[_SQUARE, y] + zs[_SQUARE, z])),
        hashes,
    )


@inlined
def _fill_row(
    at_y: np.float32,
    height: _Floats,
    ways: _Floats,
    bits: _Words,
    first: _Across,
    second: _Across,
    row: _Floats,
) -> None:
    """Write one row: the larger of the ground and of the caves, which are simplex noise."""
    for i in range(ROW):
        value = np.float32(_two_corners(i, ways[0], bits[0], first, _ROUND_2) + _ZERO)
        value = np.float32(_two_corners(i, ways[1], bits[1], second, _ROUND_1) + value)
        cave = np.float32(np.float32(_SCALE_3 * value) - np.float32(0.6)) * np.float32(6)
        ground = np.float32(at_y - np.float32(height[i] * np.float32(24)))
        value = choose(ground > cave, ground, cave)
        value = choose(value > -_LIMIT, value, -_LIMIT)
        row[i] = choose(value < _LIMIT, value, _LIMIT)


@inlined
def _two_corners(i: int, ways: _Floats, bits: _Words, across: _Across, multiplier: np.uint32) -> np.float32:
    """Return what the nearest corner of a lattice makes of a sample, and the next one along one axis."""
    (y, z), (far_y, far_z), side, left, (near_bits, far_bits) = across
    x, far_x, side_x = ways[_AT, i], ways[_FAR, i], ways[_SIDE, i]
    left = np.float32(left - ways[_SQUARE, i])
    along_x = side_x >= side
    first = _corner(_stir(np.uint32(bits[_BITS, i] + near_bits), multiplier), x, y, z, left)
    turned = choose(along_x, np.uint32(bits[_FAR_BITS, i] + near_bits), np.uint32(bits[_BITS, i] + far_bits))
    way = choose(along_x, far_x, x), choose(along_x, y, far_y), choose(along_x, z, far_z)
    left = np.float32(left + choose(along_x, side_x, side))
    return np.float32(first + _corner(_stir(turned, multiplier), way[0], way[1], way[2], left))


@inlined
def _corner(bits: np.uint32, dx: np.float32, dy: np.float32, dz: np.float32, left: np.float32) -> np.float32:
    third = np.int32(np.uint32(bits << np.uint32(2)))
    u, v = choose(third < -_THIRD_OF_HASHES, dy, dx), choose(third > _THIRD_OF_HASHES, dy, dz)
    slope = np.float32(_flip(u, bits) + _flip(v, np.uint32(bits << np.uint32(1))))
    near = choose(left > _ZERO, left, _ZERO)
    near = np.float32(near * near)
    return np.float32(np.float32(near * near) * slope)
