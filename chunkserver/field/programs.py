"""What is left of a tape in a region: branches of `min`, `max` and `select` that cannot show there are not worked out.

Regions with the same branches left share a program. Its values are the tape's own, to the bit: where bounds show which
operand a `max` takes, it takes that one without looking at the other.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.value_bounds import SLACK
from chunkserver.kernel import inlined

PROGRAMS_MAX: Final = 24
"""Of one box; regions that would need more get the whole tape."""
WHOLE: Final = 0
"""The program that is the whole tape."""

LEFT_OUT, AS_IT_IS, TAKE_A, TAKE_B, TAKE_C = (np.uint8(state) for state in range(5))
"""What becomes of an instruction."""

_Floats = NDArray[np.float32]
_Code = NDArray[np.int32]
_States = NDArray[np.uint8]


@inlined
def prune(
    code: _Code,
    numbers: NDArray[np.float64],
    reads: _Code,
    columns: int,
    low: _Floats,
    high: _Floats,
    region: int,
    states: _States,
) -> None:
    """Write what becomes of each instruction in one region.

    code, reads: of the tape that keeps all registers. columns: instructions before this one are left as they are.
    low, high: (value registers, regions), as in `intervals.Bounds`. states: (instructions,) out.
    """
    last = code.shape[0] - 1
    for at in range(last):
        states[at] = LEFT_OUT
    states[last] = AS_IT_IS
    for at in range(last, -1, -1):
        if states[at] == LEFT_OUT:
            continue
        if at >= columns and code[at, ops.CODE] >= ops.MIN:
            a, b, number = code[at, ops.A], code[at, ops.B], code[at, ops.NUMBERS]
            first, second = numbers[number], numbers[number + 1]
            states[at] = _taken(
                code[at, ops.CODE], low[a, region], high[a, region], low[b, region], high[b, region], first, second
            )
        for operand in range(6):
            is_taken = states[at] == AS_IT_IS or operand == states[at] - TAKE_A
            if is_taken and reads[at, operand] >= 0:
                states[reads[at, operand]] = AS_IT_IS


@inlined
def _taken(op: int, a0: np.float32, a1: np.float32, b0: np.float32, b1: np.float32, n0: float, n1: float) -> np.uint8:
    """Return which operand an instruction takes all over a region, or AS_IT_IS."""
    if op == ops.SELECT:
        if a0 >= np.float32(n1):
            return TAKE_C
        # Of 0 and -0 the blend makes 0.
        decided = a1 <= np.float32(n0) and a1 < np.float32(n1) and (b0 > 0 or b1 < 0)
        return TAKE_B if decided else AS_IT_IS
    margin = 0.0
    if op in (ops.SMOOTH_MIN, ops.SMOOTH_MAX):
        largest = max(abs(a0), abs(a1), abs(b0), abs(b1))
        margin = n0 + SLACK * (n0 + np.float64(largest))
    elif op not in (ops.MIN, ops.MAX):
        return AS_IT_IS
    a_above, b_above = np.float64(a0) - np.float64(b1) > margin, np.float64(b0) - np.float64(a1) > margin
    lower = op in (ops.MIN, ops.SMOOTH_MIN)
    if a_above:
        return TAKE_B if lower else TAKE_A
    if b_above:
        return TAKE_A if lower else TAKE_B
    return AS_IT_IS


@inlined
def find_program(states: _States, known: _States, count: int) -> int:
    """Return the number of the program with these states: `count` if it is a new one, which is added.

    known: (PROGRAMS_MAX, instructions), the states of the first `count` programs. WHOLE if it has no room for more.
    """
    n = states.size
    for number in range(count):
        at = 0
        while at < n and known[number, at] == states[at]:
            at += 1
        if at == n:
            return number
    if count == PROGRAMS_MAX:
        return WHOLE
    for at in range(n):
        known[count, at] = states[at]
    return count


@inlined
def write_programs(
    code: _Code,
    keys: NDArray[np.uint32],
    columns: int,
    known: _States,
    count: int,
    out: _Code,
    out_keys: NDArray[np.uint32],
    starts: _Code,
) -> None:
    """Write the code of all programs, one after the other, behind what does not depend on y.

    out, out_keys, starts: as `interpreter.run` wants them.
    """
    for at in range(columns):
        _copy(code, keys, at, AS_IT_IS, out, out_keys, at)
    to = starts[0] = columns
    for number in range(count):
        for at in range(columns, code.shape[0]):
            if known[number, at] != LEFT_OUT:
                _copy(code, keys, at, known[number, at], out, out_keys, to)
                to += 1
        starts[number + 1] = to


@inlined
def _copy(
    code: _Code,
    keys: NDArray[np.uint32],
    at: int,
    state: np.uint8,
    out: _Code,
    out_keys: NDArray[np.uint32],
    to: int,
) -> None:
    for column in range(ops.COLUMNS):
        out[to, column] = code[at, column]
    for axis in range(3):
        out_keys[to, axis] = keys[at, axis]
    if state != AS_IT_IS:
        taken = code[at, ops.A + np.int64(state) - np.int64(TAKE_A)]
        out[to, ops.CODE], out[to, ops.A], out[to, ops.B] = ops.MAX, taken, taken
