"""Cellular noise (Worley): a feature point in each lattice cell; what counts is how far the nearest ones are.

A cell is the unit square or cube around a whole number. Its feature point lies at the middle plus jitter * (u - 1/2),
u random in [0, 1) along each axis. Only the 3^d cells around a point's own are searched, and F1 and F2, the distances
to the nearest and the second nearest feature point, end at 1: whatever lies outside those cells is at least 1 away, so
the capped distances are exact, and continuous, for any jitter in [0, 1].

The lattice shows: distances depend on where in its cell a point lies, the more so the less jitter there is. So noises
of different seeds but equal frequency are a little alike, by a correlation of up to 0.03 at jitter 1 and 0.5 at 0.5.

Loop 2 is one pass over the block for each column of three cells along z. That keeps the code small, and all of it in
registers; F1, F2 and the nearest point's hash wait in scratch rows from one column to the next.

Source: S. Worley, "A Cellular Texture Basis Function" (1996): F1 and F2.
"""

from typing import Final

import numpy as np

from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BLOCK,
    ONE,
    PAGE,
    ROUND_1,
    ROUND_2,
    ROW,
    ZERO,
    Doubles,
    Floats,
    Words,
    split2,
    split3,
    stir,
    unit,
)
from chunkserver.kernel import inlined, kernel

DISTANCE: Final = 0
EDGE: Final = 1
VALUE: Final = 2
"""What is returned, numbers[6]: F1; F2 - F1; or a random number in [-1, 1] of the nearest feature point.

F1 and F2 - F1 are in [0, 1]. Where F1 is 1 (5 of 10,000 places in the plane at jitter 1, 8 in space, none in 10^6 up to
jitter 0.5), a point outside the searched cells may be nearer than the one whose value is given."""

_FAR: Final = np.float32(64)
"""Squared distance that no feature point of the searched cells reaches."""
_GRAIN: Final = np.float32(2.0**-16)
"""u is a multiple of it."""
_HALF_WORD: Final = np.uint32(16)

# Rows of scratch behind those that a split fills. Fractions: F1 and F2, squared. Words: three hashes of each axis, of
# the cells below, at and above the point's; and the hash of the nearest feature point.
_NEAREST: Final = 3 * ROW
_SECOND: Final = 4 * ROW
_X: Final = 6 * ROW
_Y: Final = 9 * ROW
_Z: Final = 12 * ROW
_WINNER: Final = 15 * ROW


@kernel
def add_cellular2(
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
    """Write below + amplitude * 2-D cellular noise. Arguments: see the package; numbers[5:7] are jitter and what."""
    spread = np.float32(numbers[5]) * _GRAIN
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        n = stop - start
        split2(x[start:stop], z[start:stop], numbers, fractions, words)
        _hash_cells(words[:_X], words[_X:_Y], n, AXIS_X, keys[0])
        _hash_cells(words[2 * ROW : _X], words[_Z:_WINNER], n, AXIS_Z, keys[2])
        fractions[_NEAREST : _SECOND + ROW] = _FAR
        for at_x in range(3):
            _column2(fractions, words, words[_X + at_x * ROW :], n, np.float32(at_x - 1), spread)
        _finish(fractions, words, numbers, below[start:stop], out[start:stop])


@kernel
def add_cellular3(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
    width: int,  # noqa: ARG001 - all noises have one signature
) -> None:
    """Write below + amplitude * 3-D cellular noise. Arguments: see the package; numbers[5:7] are jitter and what."""
    spread = np.float32(numbers[5]) * _GRAIN
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        n = stop - start
        split3(x[start:stop], y[start:stop], z[start:stop], numbers, fractions, words)
        _hash_cells(words[:_X], words[_X:_Y], n, AXIS_X, keys[0])
        _hash_cells(words[2 * ROW : _X], words[_Y:_Z], n, AXIS_Y, keys[1])
        _hash_cells(words[4 * ROW : _X], words[_Z:_WINNER], n, AXIS_Z, keys[2])
        fractions[_NEAREST : _SECOND + ROW] = _FAR
        for at_x in range(3):
            for at_y in range(3):
                xs, ys = words[_X + at_x * ROW :], words[_Y + at_y * ROW :]
                _column3(fractions, words, xs, ys, n, np.float32(at_x - 1), np.float32(at_y - 1), spread)
        _finish(fractions, words, numbers, below[start:stop], out[start:stop])


@kernel
def _hash_cells(coordinates: Words, hashes: Words, n: int, axis: np.uint32, key: np.uint32) -> None:
    """Hash n coordinates, a row of low and a row of high words, into three rows: one below, itself, one above."""
    for i in range(n):
        low = coordinates[i]
        here = np.uint32(np.uint32(low * axis) + np.uint32(np.uint32(coordinates[i + ROW] * PAGE) + key))
        down = np.uint32(here - axis) - (PAGE if low == np.uint32(0) else np.uint32(0))
        up = np.uint32(here + axis) + (PAGE if low == np.uint32(0xFFFFFFFF) else np.uint32(0))
        hashes[i] = stir(np.uint32(down), ROUND_1)
        hashes[i + ROW] = stir(here, ROUND_1)
        hashes[i + 2 * ROW] = stir(np.uint32(up), ROUND_1)


@kernel
def _column2(fractions: Floats, words: Words, xs: Words, n: int, step: np.float32, spread: np.float32) -> None:
    """Rank the feature points of the three cells `step` cells along x. xs: their hashes of x."""
    for i in range(n):
        dx, fz = np.float32(step - fractions[i]), fractions[i + ROW]
        first, second, winner = fractions[i + _NEAREST], fractions[i + _SECOND], words[i + _WINNER]
        for at_z in range(3):
            bits = stir(np.uint32(xs[i] + words[i + _Z + at_z * ROW]), ROUND_2)
            away_x = np.float32(dx + _shift(bits, spread))
            away_z = np.float32(np.float32(np.float32(at_z - 1) - fz) + _shift(stir(bits, ROUND_1), spread))
            square = np.float32(np.float32(away_x * away_x) + np.float32(away_z * away_z))
            first, second, winner = _rank(square, bits, first, second, winner)
        fractions[i + _NEAREST], fractions[i + _SECOND], words[i + _WINNER] = first, second, winner


@kernel
def _column3(
    fractions: Floats,
    words: Words,
    xs: Words,
    ys: Words,
    n: int,
    step_x: np.float32,
    step_y: np.float32,
    spread: np.float32,
) -> None:
    """Rank the feature points of the three cells (step_x, step_y) cells away. xs, ys: their hashes of x and y."""
    for i in range(n):
        dx, dy = np.float32(step_x - fractions[i]), np.float32(step_y - fractions[i + ROW])
        fz = fractions[i + 2 * ROW]
        across = np.uint32(xs[i] + ys[i])
        first, second, winner = fractions[i + _NEAREST], fractions[i + _SECOND], words[i + _WINNER]
        for at_z in range(3):
            bits = stir(np.uint32(across + words[i + _Z + at_z * ROW]), ROUND_2)
            more = stir(bits, ROUND_1)
            away_x, away_y = np.float32(dx + _shift(bits, spread)), np.float32(dy + _shift(more, spread))
            away_z = np.float32(np.float32(at_z - 1) - fz) + _shift(np.uint32(more << _HALF_WORD), spread)
            square = np.float32(np.float32(away_x * away_x) + np.float32(away_y * away_y))
            square = np.float32(square + np.float32(away_z * away_z))
            first, second, winner = _rank(square, bits, first, second, winner)
        fractions[i + _NEAREST], fractions[i + _SECOND], words[i + _WINNER] = first, second, winner


@inlined
def _shift(bits: np.uint32, spread: np.float32) -> np.float32:
    """Return jitter * (u - 1/2), u made of the upper 16 bits, where `spread` is jitter * _GRAIN."""
    return np.float32(spread * np.float32(np.int32(bits) >> np.int32(16)))


@inlined
def _rank(
    square: np.float32, bits: np.uint32, first: np.float32, second: np.float32, winner: np.uint32
) -> tuple[np.float32, np.float32, np.uint32]:
    """Return the two smallest squares so far and the hash that belongs to the smallest."""
    closer = square < first
    loser = first if closer else square
    return square if closer else first, loser if loser < second else second, bits if closer else winner


@kernel
def _finish(fractions: Floats, words: Words, numbers: Doubles, below: Floats, out: Floats) -> None:
    """Write below + amplitude * what numbers[6] asks for."""
    amplitude, what = np.float32(numbers[0]), numbers[6]
    near = ONE if what == DISTANCE else (-ONE if what == EDGE else ZERO)
    far, value = ONE if what == EDGE else ZERO, ONE if what == VALUE else ZERO
    for i in range(out.size):
        first, second = fractions[i + _NEAREST], fractions[i + _SECOND]
        distances = np.float32(near * np.sqrt(first if first < ONE else ONE))
        distances = np.float32(distances + np.float32(far * np.sqrt(second if second < ONE else ONE)))
        winner = stir(stir(words[i + _WINNER], ROUND_1), ROUND_2)
        noise = np.float32(distances + np.float32(value * unit(winner)))
        out[i] = below[i] + np.float32(amplitude * noise)
