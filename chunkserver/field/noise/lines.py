"""Noise blended over squares or cubes, line by line: what depends on one axis, and on two, is worked out once.

A cell is the unit square or cube around a whole number, so corners lie half-way between whole numbers. In a row of
points x varies alone, and the corners around it lie on two lines along x in the plane: those below the row in z, and
those above. Of each line, all that a point's x (and y) leaves open is a value and a slope along z:

    noise(x, z) = mix(value0 + slope0 * (z - z0), value1 + slope1 * (z - z1), quintic(z - z0))

`gradient` and `value` make such lines; value noise has no slopes. The next row mostly lies between the same two lines.
A point that is in no row has two lines of its own.

Scratch rows of BLOCK numbers, made here: of each axis where a point lies, from the middle of its cell, and how far it
is blended over; and the hashes of its lower and its higher corner. Then those of two lines, each a row of values and
one of slopes. LOW and HIGH are the hashes that a line to be made has across x: of its z, added to those of the lower
and of the higher y; LOW alone in the plane.
"""

from typing import Final

import numpy as np

from chunkserver.field.noise.lattice import AXES, HALF, HERE, ROW, ZERO, Doubles, Floats, Words, axis_hashes, split
from chunkserver.kernel import inlined, kernel

AXIS_ROWS: Final = 2 * ROW
"""From one axis to the next, of fractions and of words."""
X_AT: Final = 0
X_BLEND: Final = ROW
Y_AT: Final = 2 * ROW
Z_AT: Final = 4 * ROW
LINE_Y: Final = 6 * ROW
"""The y of each point of a line to be made: two rows, as of an axis."""
LINES: Final = 8 * ROW
LINE: Final = 2 * ROW
"""From the one line to the other."""

X_LOW: Final = 0
X_HIGH: Final = ROW
Y_LOW: Final = 2 * ROW
Z_LOW: Final = 4 * ROW
LOW: Final = 6 * ROW
HIGH: Final = 7 * ROW


@kernel
def read_axes(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    solid: bool,
    start: int,
    across: int,
    step: int,
    n: int,
    numbers: Doubles,
    keys: Words,
    fractions: Floats,
    words: Words,
) -> None:
    """Write the rows of each axis: of `across` points along x; and of n in y and z, `step` from one to the next."""
    for axis in range(0, 3, 1 if solid else 2):
        place = x if axis == 0 else (y if axis == 1 else z)
        stride, count = (1, across) if axis == 0 else (step, n)
        own_fractions, own_words = fractions[AXIS_ROWS * axis :], words[AXIS_ROWS * axis :]
        split(axis, place, start, stride, count, numbers, own_fractions, own_words)
        multiplier, key = AXES[axis], keys[axis]
        for i in range(count):
            low, high = own_words[i], own_words[i + ROW]
            own_words[i], own_words[i + ROW] = axis_hashes(low, high, HERE, multiplier, key)
            own_fractions[i + ROW] = quintic(np.float32(own_fractions[i] + HALF))


@kernel
def spread(solid: bool, in_rows: bool, row: int, side: int, n: int, fractions: Floats, words: Words) -> None:
    """Write LOW, HIGH and LINE_Y of n points: each has its own y and z, or all those of one row.

    side: 0 for the line below the points in z, 1 for that above.
    """
    y, z, y_words = fractions[Y_AT:], words[Z_LOW + side * ROW :], words[Y_LOW:]
    if in_rows:
        low, high = (
            (np.uint32(z[row] + y_words[row]), np.uint32(z[row] + y_words[row + ROW])) if solid else (z[row], HERE)
        )
        at, blend = (y[row], y[row + ROW]) if solid else (ZERO, ZERO)
        for i in range(n):
            words[i + LOW], words[i + HIGH] = low, high
            fractions[i + LINE_Y], fractions[i + LINE_Y + ROW] = at, blend
    elif solid:
        for i in range(n):
            words[i + LOW], words[i + HIGH] = np.uint32(z[i] + y_words[i]), np.uint32(z[i] + y_words[i + ROW])
            fractions[i + LINE_Y], fractions[i + LINE_Y + ROW] = y[i], y[i + ROW]
    else:
        for i in range(n):
            words[i + LOW] = z[i]


@inlined
def quintic(t: np.float32) -> np.float32:
    """Return 6t^5 - 15t^4 + 10t^3: 0 to 1 with two zero derivatives at both ends."""
    inner = np.float32(t * np.float32(np.float32(t * np.float32(6)) - np.float32(15)) + np.float32(10))
    return np.float32(np.float32(np.float32(t * t) * t) * inner)


@inlined
def mix(low: np.float32, high: np.float32, share: np.float32) -> np.float32:
    """Return low at share 0, high at share 1, linear in between."""
    return np.float32(low + np.float32(share * np.float32(high - low)))
