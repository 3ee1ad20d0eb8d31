"""Gradient and value noise, of points in rows or anywhere: the lines they lie between, and what those make of z."""

from typing import Final

import numpy as np

from chunkserver.field import ops
from chunkserver.field.noise.gradient import GRADIENT2_SCALE, GRADIENT3_SCALE, gradient_line2, gradient_line3
from chunkserver.field.noise.lattice import BLOCK, HALF, ONE, ROW, ROW_LEAST, Doubles, Floats, Words, whole_vectors
from chunkserver.field.noise.lines import LINE, LINES, Y_AT, Y_LOW, Z_AT, Z_LOW, mix, read_axes, spread
from chunkserver.field.noise.value import value_line2, value_line3
from chunkserver.kernel import inlined, kernel, spliced

_NONE: Final = np.uint64(1 << 32)
"""No hash: of a line that is not made yet."""


@kernel
def add_blended(
    op: int,
    x: Doubles,
    y: Doubles,
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
    width: int,
) -> None:
    """Write below + amplitude * noise in [-1, 1], mean 0: GRADIENT2, GRADIENT3, VALUE2 or VALUE3. See the package."""
    in_rows, solid = ROW_LEAST <= width <= BLOCK, op == ops.GRADIENT3 or op == ops.VALUE3  # noqa: PLR1714 - cheaper
    step = width if in_rows else 1
    for start in range(0, out.size, BLOCK * step):
        n = min(BLOCK, (out.size - start) // step)
        across = min(whole_vectors(width), x.size - start) if in_rows else n
        read_axes(x, y, z, solid, start, across, step, n, numbers, keys, fractions, words)
        row, turned = min(0, n), 0  # not the literal 0: Numba would compile all that `row` is passed to twice
        at_lower, at_upper = _NONE, _NONE
        while row < n:
            end = _end_of_cell(solid, row, n, fractions, words) if in_rows else n
            if row and solid and not _same_y(row, fractions, words):
                at_lower, at_upper = _NONE, _NONE
            if np.uint64(words[row + Z_LOW]) == at_upper:
                turned, at_lower, at_upper = 1 - turned, at_upper, _NONE
            for side in range(2):
                if not in_rows or np.uint64(words[row + Z_LOW + side * ROW]) != (at_upper if side else at_lower):
                    spread(solid, in_rows, row, side, across, fractions, words)
                    _make_line(op, across, fractions, words, LINES + (side ^ turned) * LINE)
            at_lower, at_upper = np.uint64(words[row + Z_LOW]), np.uint64(words[row + Z_LOW + ROW])
            _put(op, in_rows, width, row, end, turned, start, numbers, fractions, below, out)
            row = end


@inlined
def _end_of_cell(solid: bool, row: int, rows: int, fractions: Floats, words: Words) -> int:
    """Return the first row after `row` that does not lie between the same two lines."""
    end = row + 1
    while (
        end < rows and words[end + Z_LOW] == words[row + Z_LOW] and words[end + Z_LOW + ROW] == words[row + Z_LOW + ROW]
    ):
        if solid and not _same_y(end, fractions, words):
            break
        end += 1
    return end


@inlined
def _same_y(row: int, fractions: Floats, words: Words) -> bool:
    """Return whether a row has the y of the row before."""
    at, low, high = row + Y_AT, row + Y_LOW, row + Y_LOW + ROW
    same_cell = words[low] == words[low - 1] and words[high] == words[high - 1]
    return bool(same_cell and fractions[at] == fractions[at - 1])


@spliced
def _make_line(op: int, n: int, fractions: Floats, words: Words, into: int) -> None:
    if op == ops.GRADIENT2:
        gradient_line2(n, fractions, words, into)
    elif op == ops.GRADIENT3:
        gradient_line3(n, fractions, words, into)
    elif op == ops.VALUE2:
        value_line2(n, fractions, words, into)
    else:
        value_line3(n, fractions, words, into)


@kernel
def _put(
    op: int,
    in_rows: bool,
    width: int,
    row: int,
    end: int,
    turned: int,
    start: int,
    numbers: Doubles,
    fractions: Floats,
    below: Floats,
    out: Floats,
) -> None:
    """Write points of rows between two lines, or with lines of their own. turned: the upper line is the first."""
    amplitude, lower, upper = (
        np.float32(numbers[0]),
        fractions[LINES + turned * LINE :],
        fractions[LINES + LINE - turned * LINE :],
    )
    scale = GRADIENT2_SCALE if op == ops.GRADIENT2 else (GRADIENT3_SCALE if op == ops.GRADIENT3 else ONE)
    if in_rows:
        for at_row in range(row, end):
            at, blend, first = (
                fractions[at_row + Z_AT],
                fractions[at_row + Z_AT + ROW],
                np.uint64(start + at_row * width),
            )
            for i in range(width):
                place = np.uint64(first + np.uint64(i))
                value = _between(i, at, blend, lower, upper)
                out[place] = below[place] + np.float32(amplitude * np.float32(scale * value))
    else:
        belows, outs = below[start:], out[start:]
        for i in range(end):
            value = _between(i, fractions[i + Z_AT], fractions[i + Z_AT + ROW], lower, upper)
            outs[i] = belows[i] + np.float32(amplitude * np.float32(scale * value))


@inlined
def _between(i: int, at: np.float32, blend: np.float32, lower: Floats, upper: Floats) -> np.float32:
    """Return what two lines make of a point that lies at `at` along z, from the middle of its cell."""
    below = np.float32(lower[i] + np.float32(lower[i + ROW] * np.float32(at + HALF)))
    above = np.float32(upper[i] + np.float32(upper[i + ROW] * np.float32(at - HALF)))
    return mix(below, above, blend)
