"""Steps that one pass over the points can do together, made one step: the same value, to the bit.

    (noise - 0.6) * 6      SUBTRACT, MULTIPLY, two constants      ->  LINEAR
    y - noise              COORDINATE, SUBTRACT                   ->  ABOVE

A step that is fused away is left off the tape if nothing else reads it. Each operation is still rounded by itself:
`a - c` is `a + (-c)`, `c - a` is `a * (-1) + c`, and multiplying by 1, or adding NOTHING, changes no number.
"""

import math
from collections.abc import Sequence
from typing import Final

from chunkserver.field import ops
from chunkserver.field.tape import Step

NOTHING: Final = -0.0
"""What is added to any number, -0 included, without changing it."""


def fused(steps: Sequence[Step]) -> list[Step]:
    """Return the steps of the same values, in the same places, that take fewer passes."""
    found: list[Step] = []
    for step in steps:
        found.append(_fused(step, found))
    return found


def _fused(step: Step, before: Sequence[Step]) -> Step:
    if step.op not in (ops.ADD, ops.SUBTRACT, ops.MULTIPLY):
        return step
    a, b = before[step.a], before[step.b]
    if step.op == ops.SUBTRACT and a.op == ops.COORDINATE:
        return Step(ops.ABOVE, step.b, x=a.x)
    if ops.CONSTANT not in (a.op, b.op):
        return step
    number, place = (b.numbers[0], step.a) if b.op == ops.CONSTANT else (a.numbers[0], step.b)
    if step.op == ops.MULTIPLY:
        return _times(place, before[place], number)
    if step.op == ops.ADD:
        return _plus(place, before[place], number)
    if b.op == ops.CONSTANT:
        return _plus(place, before[place], -number)
    return _plus(place, _times(place, before[place], -1.0), number)


def _times(place: int, step: Step, number: float) -> Step:
    """Return `number` times the value of `step`, which is at `place`."""
    if step.op == ops.LINEAR and step.numbers[1] == 1 and _is_nothing(step.numbers[2]):
        return step._replace(numbers=(step.numbers[0], number, NOTHING))
    return Step(ops.LINEAR, place, numbers=(NOTHING, number, NOTHING))


def _plus(place: int, step: Step, number: float) -> Step:
    """Return the value of `step`, which is at `place` or has room, plus `number`."""
    if step.op == ops.LINEAR and _is_nothing(step.numbers[2]):
        return step._replace(numbers=(*step.numbers[:2], number))
    return Step(ops.LINEAR, place, numbers=(number, 1.0, NOTHING))


def _is_nothing(number: float) -> bool:
    return number == 0 and math.copysign(1, number) < 0
