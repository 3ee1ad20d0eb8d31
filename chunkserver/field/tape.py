"""A tape: a list of instructions over registers, in the arrays that the interpreter runs.

Steps are written in single-assignment form: each makes one value or one coordinate, and names the places of the steps
that it reads. `allocate` puts those that do not depend on y first and gives each a register, which is free again after
its last use:

    max(subtract(y, multiply(fbm2, 24)), ...)      ->      0  CONSTANT   r0          0
                                                           1  GRADIENT2  r1 <- r0    first octave
                                                           2  GRADIENT2  r0 <- r1    second octave
                                                           ...
                                                           ----------------------    below: once per horizontal plane
                                                           7  ABOVE      r1 <- r0    y, less what is in r0
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadRecipe
from chunkserver.field import ops

REGISTERS_MAX: Final = 512
"""Of each kind: 8 MB for a slab; twice where rows are listed."""
INPUTS: Final = 3
"""The first three steps are the point's x, y, z. They are given, not worked out."""
NONE: Final = -1

Reads = dict[int, set[int]]
"""Place of a step -> places of all that it reads."""


class Step(NamedTuple):
    """One step: `a`, `b`, `c` are places of values, `x`, `y`, `z` of coordinates, NONE for none."""

    op: int
    a: int = NONE
    b: int = NONE
    c: int = NONE
    x: int = NONE
    y: int = NONE
    z: int = NONE
    numbers: tuple[float, ...] = ()
    keys: tuple[int, ...] = (0, 0, 0)

    @property
    def operands(self) -> set[int]:
        """Places of all that it reads."""
        places = {self.a, self.b, self.c, self.x, self.y, self.z}
        places.discard(NONE)
        return places

    @property
    def is_coordinate(self) -> bool:
        """Whether it makes a coordinate, not a value."""
        return self.op <= ops.COORDINATE_LAST


@dataclass(frozen=True, slots=True, eq=False)
class Tape:
    """What the interpreter runs.

    code: (n, ops.COLUMNS) int32: op, register that is written, registers that are read, place in `numbers`.
    numbers: float64, the constants of all instructions, one after the other.
    keys: (n, 3) uint32, noise hash keys of the axes.
    columns: how many leading instructions do not depend on y.
    starts: (2,) int32, where the others start in the code, and its end.
    places, values: how many coordinate and value registers the code uses.
    result: the value register that holds the density at the end.
    order: the place of the step of each instruction.
    reads: (n, 6) int32: which instructions made what it reads as a, b, c, x, y, z; NONE for none, and for the inputs.
    shared_places, shared_values: int32, the registers that planes read of columns.
    """

    code: NDArray[np.int32]
    numbers: NDArray[np.float64]
    keys: NDArray[np.uint32]
    columns: int
    starts: NDArray[np.int32]
    places: int
    values: int
    result: int
    order: tuple[int, ...]
    reads: NDArray[np.int32]
    shared_places: NDArray[np.int32]
    shared_values: NDArray[np.int32]


def allocate(steps: Sequence[Step], root: int, keep: bool = False) -> Tape:
    """Return the tape that works out `root`.

    keep: give each step a register of its own, for bounds, which want all values at once. The instructions are the
        same, in the same order; only registers differ, and REGISTERS_MAX does not apply.

    Raises `BadRecipe` if it needs more than REGISTERS_MAX registers.
    """
    reads = _reachable(steps, root)
    on_y = _on_y(reads)
    order = sorted(reads, key=lambda place: place in on_y)
    last_use = _last_uses(reads, order, on_y, root)
    register = {place: place for place in range(INPUTS)}
    free: dict[bool, list[int]] = {True: [], False: []}
    used = {True: INPUTS, False: 0}
    for at, place in enumerate(order):
        kind = steps[place].is_coordinate
        if not free[kind]:
            free[kind].append(used[kind])
            used[kind] += 1
        register[place] = free[kind].pop()
        for operand in reads[place]:
            if last_use[operand] == at and operand >= INPUTS and not keep:
                free[steps[operand].is_coordinate].append(register[operand])
    if max(used.values()) > REGISTERS_MAX and not keep:
        count = max(used.values())
        message = f"recipe needs {count} registers; the limit is {REGISTERS_MAX}: fewer different constants need fewer"
        raise BadRecipe(message, registers=count)
    return _assemble(steps, order, register, on_y, used, register[root])


def _reachable(steps: Sequence[Step], root: int) -> Reads:
    """Return what each step that `root` needs reads: itself included, operands first, without the inputs."""
    needed = {root}
    reads = {}
    for place in range(root, INPUTS - 1, -1):
        if place in needed:
            reads[place] = steps[place].operands
            needed |= reads[place]
    return dict(reversed(reads.items()))


def _on_y(reads: Reads) -> set[int]:
    """Return the places whose value differs from one horizontal plane to the next."""
    on_y = {1}
    for place, operands in reads.items():
        if not on_y.isdisjoint(operands):
            on_y.add(place)
    return on_y


def _in_rows(steps: Sequence[Step], order: Sequence[int]) -> list[bool]:
    """Return of each instruction whether the x that it reads is that of its column, and y and z those of its row."""
    depends: dict[int, set[int]] = {place: {place} for place in (NONE, *range(INPUTS))}
    for place in order:
        depends[place] = set().union(*(depends[operand] for operand in steps[place].operands))
    along, across = {NONE, 0}, {NONE, 1, 2}
    found = []
    for place in order:
        step = steps[place]
        beside = depends[step.z] if step.op in ops.FLAT else depends[step.y] | depends[step.z]
        found.append(depends[step.x] <= along and beside <= across)
    return found


def _last_uses(reads: Reads, order: Sequence[int], on_y: set[int], root: int) -> dict[int, int]:
    """Return where on the tape each step is read last. The root, and what planes read of columns, live to the end."""
    last_use = {place: at for at, place in enumerate(order)}
    for at, place in enumerate(order):
        crosses = place in on_y
        for operand in reads[place]:
            last_use[operand] = len(order) if crosses and operand not in on_y else max(at, last_use.get(operand, at))
    last_use[root] = len(order)
    return last_use


def _assemble(
    steps: Sequence[Step],
    order: Sequence[int],
    register: dict[int, int],
    on_y: set[int],
    used: dict[bool, int],
    result: int,
) -> Tape:
    """Return the arrays. What an instruction does not read is register 0 of its kind: it must exist, that is all."""
    chosen = [steps[place] for place in order]
    registers = np.zeros(len(steps) + 1, np.int32)  # the last one is that of NONE
    registers[list(register)] = list(register.values())
    made_at = np.full(len(steps) + 1, NONE, np.int32)
    made_at[list(order)] = np.arange(len(order))
    read = [(step.a, step.b, step.c, step.x, step.y, step.z) for step in chosen]
    numbers = list(chain.from_iterable(step.numbers for step in chosen))
    code = np.empty((len(order), ops.COLUMNS), np.int32)
    code[:, ops.CODE] = [step.op for step in chosen]
    code[:, ops.OUT] = registers[list(order)]
    code[:, ops.A : ops.NUMBERS] = registers[read]
    code[:, ops.IN_ROWS] = _in_rows(steps, order)
    code[:, ops.NUMBERS] = list(accumulate((len(step.numbers) for step in chosen[:-1]), initial=0))
    columns = sum(place not in on_y for place in order)
    needed = {operand for step in chosen[columns:] for operand in step.operands} | {order[-1]}
    shared = sorted(needed & {0, 2, *order[:columns]})
    is_place = [place < INPUTS or steps[place].is_coordinate for place in shared]
    return Tape(
        code,
        np.array([*numbers, *[0.0] * ops.NUMBERS_LONGEST]),
        np.array([step.keys for step in chosen], np.uint32),
        columns,
        np.array([columns, len(order)], np.int32),
        used[True],
        max(1, used[False]),
        result,
        tuple(order),
        made_at[read],
        np.array([register[place] for place, is_one in zip(shared, is_place, strict=True) if is_one], np.int32),
        np.array([register[place] for place, is_one in zip(shared, is_place, strict=True) if not is_one], np.int32),
    )
