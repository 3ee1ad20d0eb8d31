"""What writes the steps of a tape: equal steps once, constants worked out, each subtree in its own frame."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from chunkserver.field import ops
from chunkserver.field.levels import weight
from chunkserver.field.points import run_at
from chunkserver.field.tape import INPUTS, NONE, Step, allocate
from chunkserver.recipe import nodes

Places = tuple[int, int, int]
Writers = Mapping[type[nodes.Node], Callable[[Any, Any, "Frame"], int]]
"""Model of a node -> what writes it: (writer, node, frame) -> place of its value."""

ORIGIN: Final[Places] = (NONE, NONE, NONE)


class Frame(NamedTuple):
    """What a subtree sees.

    places: the coordinates of the point.
    cells: the cell of the innermost `repeat`; NONE along an axis without one.
    scale: voxels per unit of these coordinates, for feature sizes.
    path: where the subtree stands in the recipe, as a user writes it.
    """

    places: Places = (0, 1, 2)
    cells: Places = ORIGIN
    scale: float = 1.0
    path: str = ""

    def below(self, name: str) -> "Frame":
        """Return the frame of operand `name`."""
        return self._replace(path=f"{self.path}.{name}" if self.path else name)

    def moved(self, places: Sequence[int], scale: float = 1.0) -> "Frame":
        """Return the frame of what sees other coordinates, whose unit is `scale` of these."""
        x, y, z = places
        return self._replace(places=(x, y, z), scale=self.scale * scale)


class Writer:
    """Writes steps, operands first, each distinct one once."""

    def __init__(self, seed: int, lod: int, writers: Writers) -> None:
        self.seed = seed
        self.lod = lod
        self._writers = writers
        self.steps = [Step(NONE) for _ in range(INPUTS)]
        self.paths = [""] * INPUTS
        self._places: dict[Step, int] = {}

    def put(self, step: Step, path: str) -> int:
        """Return the place of `step`, new or known; `path` says which node it comes from."""
        place = self._places.get(step)
        if place is None:
            if self._is_constant(step):
                place = self.put(Step(ops.CONSTANT, numbers=(self._value(step),)), path)
            else:
                place = len(self.steps)
                self.steps.append(step)
                self.paths.append(path)
            self._places[step] = place
        return place

    def _is_constant(self, step: Step) -> bool:
        """Whether all that a value is made of is constants."""
        if step.is_coordinate or step.op == ops.CONSTANT:
            return False
        return all(self.steps[place].op == ops.CONSTANT for place in step.operands)

    def _value(self, step: Step) -> float:
        """Return the value of a step whose operands are constants: of a tape with nothing else on it."""
        operands = sorted(step.operands)
        place = {NONE: NONE} | {operand: at for at, operand in enumerate(operands, INPUTS)}
        alone = step._replace(a=place[step.a], b=place[step.b], c=place[step.c])
        return _evaluated([*self.steps[:INPUTS], *(self.steps[operand] for operand in operands), alone])

    def constant(self, value: float, frame: Frame) -> int:
        """Return the place of a constant."""
        return self.put(Step(ops.CONSTANT, numbers=(value,)), frame.path)

    def write(self, node: nodes.Node, frame: Frame) -> int:
        """Return the place of the value of `node` in a frame."""
        return self._writers[type(node)](self, node, frame)

    def operand(self, node: nodes.Node, name: str, frame: Frame) -> int:
        """Return the place of the value of operand `name` of `node`."""
        return self.write(getattr(node, name), frame.below(name))

    def weight(self, size: float, frame: Frame) -> float:
        """Return what the level leaves of a feature of `size` units of the frame."""
        return weight(size * frame.scale, self.lod)


def _evaluated(steps: list[Step]) -> float:
    """Return the value of the last step."""
    tape = allocate(steps, len(steps) - 1)
    values = np.empty((1, tape.values, 1), np.float32)
    run_at(tape, np.zeros((1, tape.places, 1)), values)
    return float(values[0, tape.result, 0])
