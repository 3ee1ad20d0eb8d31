"""The instructions of a tape: what each reads, what it writes, which constants it has.

    coordinate registers   float64   0, 1, 2 hold the point's x, y, z; the rest are moved, turned, repeated or warped
    value registers        float32   densities, heights, weights

An instruction reads values a, b, c and coordinates x, y, z, and writes one register of either kind. Its constants start
at its place in the tape's `numbers`. IN_ROWS is 1 if x depends on the point's x alone, and y and z do not depend on it:
then the points of a row share y and z, and all rows share x.
"""

from typing import Final

LEVEL: Final = 1
"""The coordinate register of y, which all points of a plane share."""

CODE: Final = 0
OUT: Final = 1
A: Final = 2
B: Final = 3
C: Final = 4
X: Final = 5
Y: Final = 6
Z: Final = 7
NUMBERS: Final = 8
IN_ROWS: Final = 9
COLUMNS: Final = 10
"""Columns of a tape's code."""

# Coordinates. out = ...                 numbers
AFFINE: Final = 0  # x * n0 + n1
TURN: Final = 1  # (x * n0 + y * n1) + z * n2
REPEAT: Final = 2  # x - n0 * cell(x)               period, 1 / period
CELL: Final = 3  # cell(x), about round(x * n1)      period, 1 / period
WARP: Final = 4  # x + a
COORDINATE_LAST: Final = WARP

# Values of values.
COORDINATE: Final = 5  # x
HEIGHT: Final = 6  # x - a, rounded once
ABOVE: Final = 7  # x - a
ADD: Final = 8
SUBTRACT: Final = 9
MULTIPLY: Final = 10
MIN: Final = 11
MAX: Final = 12
CONSTANT: Final = 13  # n0
LINEAR: Final = 14  # ((a + n0) * n1) + n2
ABS: Final = 15
FOLD: Final = 16  # b + (n0 + n1 * |a|)
SMOOTH_MIN: Final = 17  # radius, 1 / (4 radius)
SMOOTH_MAX: Final = 18
SELECT: Final = 19  # by a: b or c                   at - width / 2, at + width / 2, 1 / width
REMAP: Final = 20  # count, then (from, to, rise, 1 / width) of each knot
ARITHMETIC_LAST: Final = REMAP

# Distances. The first number is added, the second is the least that comes out, the third how large the shape is.
PLANE: Final = 21
SPHERE: Final = 22
BOX: Final = 23
CAPSULE: Final = 24
TORUS: Final = 25
CYLINDER: Final = 26
SHAPE_LAST: Final = CYLINDER

RANDOM: Final = 27

# Noise: b + amplitude * noise. Amplitude, frequency, three offsets, jitter, returns, low, high, Lipschitz constant.
GRADIENT2: Final = 28
GRADIENT3: Final = 29
VALUE2: Final = 30
VALUE3: Final = 31
SIMPLEX2: Final = 32
SIMPLEX3: Final = 33
CELLULAR2: Final = 34
CELLULAR3: Final = 35

FLAT: Final = frozenset((GRADIENT2, VALUE2, SIMPLEX2, CELLULAR2))
"""Noises that do not read y."""

NOISE_LOW: Final = 7
NOISE_HIGH: Final = 8
NOISE_LIPSCHITZ: Final = 9
"""Where among a noise's numbers its facts stand, for the intervals."""

KNOT_NUMBERS: Final = 4
NUMBERS_LONGEST: Final = 10
"""The most numbers that an instruction reads without having counted them: a tape has as many to spare at its end."""

NANOSECONDS: Final = (
    *[0.7] * (COORDINATE_LAST + 1),
    *[0.3] * (ARITHMETIC_LAST - COORDINATE_LAST),
    *[2.0] * (SHAPE_LAST - ARITHMETIC_LAST),
    2.0,
    *[0.9, 1.5, 0.8, 1.0, 6.0, 3.3, 15.0, 23.0],
)
"""About how long an instruction takes for a point in a row, by its number, in registers that are cached (AVX2)."""

assert len(NANOSECONDS) == CELLULAR3 + 1
