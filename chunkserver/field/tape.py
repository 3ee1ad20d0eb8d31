"""A recipe flattened to a tape: a list of instructions over registers, made once per recipe, seed and level.

    max(subtract(y, multiply(fbm2, 24)), ...)      ->      0  CONSTANT   r0          0
                                                           1  GRADIENT2  r1 <- r0    first octave
                                                           2  GRADIENT2  r2 <- r1    second octave
                                                           ...
                                                           ----------------------    below: once per horizontal plane
                                                           7  Y          r0
                                                           8  SUBTRACT   r3 <- r0, r2

Instructions that do not depend on y come first and run once per chunk, for one horizontal plane of points; the rest run
for each plane. Equal instructions are kept once. What a level has faded out is not on its tape at all.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadRecipe
from chunkserver.field import interpreter as op
from chunkserver.field.levels import visible, weight
from chunkserver.field.noise import COORDINATE_MAX
from chunkserver.grid import LATTICE_MAX
from chunkserver.recipe import WorldRecipe, nodes

REGISTERS_MAX: Final = 128
TAPES_MAX: Final = 256
"""Tapes kept in one process."""

assert 2 * LATTICE_MAX * nodes.FREQUENCY_MAX < COORDINATE_MAX, "noise is defined wherever a chunk can be"

_MASK: Final = (1 << 64) - 1
_WORD: Final = (1 << 32) - 1
_GOLDEN: Final = 0x9E3779B97F4A7C15
"""2**64 / golden ratio, odd: the step of SplitMix64 (S. Vigna)."""


class Instruction(NamedTuple):
    """One step, in single-assignment form: `a` and `b` are places on the tape of the operands, -1 for none."""

    op: int
    a: int = -1
    b: int = -1
    numbers: tuple[float, ...] = ()
    keys: tuple[int, ...] = (0, 0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Tape:
    """What the interpreter runs.

    code: (n, 4) int32, rows of op, destination register, registers of a and b.
    numbers: (n, NUMBERS) float64, each instruction's constants.
    keys: (n, 3) uint32, noise hash keys of the axes.
    columns: how many leading instructions do not depend on y.
    registers: how many registers the code uses.
    result: the register that holds the density at the end.
    """

    code: NDArray[np.int32]
    numbers: NDArray[np.float64]
    keys: NDArray[np.uint32]
    columns: int
    registers: int
    result: int


@lru_cache(maxsize=TAPES_MAX)
def flatten(recipe: WorldRecipe, lod: int) -> Tape:
    """Return the tape of `recipe` at level `lod`. Raises `BadRecipe` if it needs more than REGISTERS_MAX registers."""
    writer = _Writer(recipe.seed, lod)
    root = writer.write(visible(recipe.expression, lod))
    order = sorted(range(len(writer.steps)), key=lambda place: writer.needs_y[place])
    return _allocate(writer, order, root)


@dataclass(slots=True)
class _Writer:
    """Writes instructions, operands first, each distinct one once."""

    seed: int
    lod: int
    steps: list[Instruction] = field(default_factory=list)
    needs_y: list[bool] = field(default_factory=list)
    places: dict[Instruction, int] = field(default_factory=dict)

    def put(self, step: Instruction) -> int:
        """Return the place of `step` on the tape, new or known."""
        if step not in self.places:
            self.places[step] = len(self.steps)
            self.steps.append(step)
            operands = [place for place in (step.a, step.b) if place >= 0]
            self.needs_y.append(step.op in op.READS_Y or any(self.needs_y[place] for place in operands))
        return self.places[step]

    def constant(self, value: float) -> int:
        """Return the place of a constant."""
        return self.put(Instruction(op.CONSTANT, numbers=(value,)))

    def write(self, node: nodes.Node) -> int:
        """Return the place of the value of `node`."""
        return _WRITERS[type(node)](self, node)


def _write_constant(writer: _Writer, node: nodes.Constant) -> int:
    return writer.constant(node.value)


def _write_axis(writer: _Writer, node: nodes.Axis) -> int:
    return writer.put(Instruction({"x": op.X, "y": op.Y, "z": op.Z}[node.op]))


def _write_binary(writer: _Writer, node: nodes.Binary) -> int:
    code = {"add": op.ADD, "subtract": op.SUBTRACT, "multiply": op.MULTIPLY, "min": op.MIN, "max": op.MAX}[node.op]
    return writer.put(Instruction(code, writer.write(node.a), writer.write(node.b)))


def _write_sphere(writer: _Writer, node: nodes.Sphere) -> int:
    return writer.put(Instruction(op.SPHERE, numbers=(*node.center, node.radius)))


def _write_simplex3(writer: _Writer, node: nodes.Simplex3) -> int:
    return _write_octave(writer, op.SIMPLEX3, writer.constant(0.0), 1.0, node.frequency, (node.salt, 0))


def _write_fbm(writer: _Writer, node: nodes.Fbm) -> int:
    basis = {"fbm2": op.GRADIENT2, "fbm3": op.SIMPLEX3}[node.op]
    octaves = node.bands()
    total = sum(amplitude for _, amplitude in octaves)
    place = writer.constant(0.0)
    for octave, (frequency, amplitude) in enumerate(octaves):
        place = _write_octave(writer, basis, place, amplitude / total, frequency, (node.salt, octave + 1))
    return place


def _write_octave(
    writer: _Writer, basis: int, below: int, amplitude: float, frequency: float, name: tuple[int, int]
) -> int:
    """Write `below + amplitude * noise`, faded for the level; nothing where the level has lost this octave."""
    faded = amplitude * weight(1.0 / frequency, writer.lod)
    if faded == 0.0:
        return below
    offsets, keys = noise_name(writer.seed, *name)
    return writer.put(Instruction(basis, below, numbers=(faded, frequency, *offsets), keys=keys))


_WRITERS: Final[dict[type[nodes.Node], Callable[[_Writer, Any], int]]] = {
    nodes.Constant: _write_constant,
    nodes.Axis: _write_axis,
    nodes.Binary: _write_binary,
    nodes.Sphere: _write_sphere,
    nodes.Simplex3: _write_simplex3,
    nodes.Fbm: _write_fbm,
}


def noise_name(seed: int, salt: int, octave: int) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Return what tells noises apart, for each axis: an offset in [0, 1) lattice cells and a 32-bit hash key."""
    axes = [_hash(seed, salt, octave, axis) for axis in range(3)]
    return tuple((key >> 32) / 2.0**32 for key in axes), tuple(key & _WORD for key in axes)


def _hash(*words: int) -> int:
    """Return 64 bits that all bits of all words reach: SplitMix64's finish (S. Vigna), once a word."""
    key = 0
    for word in words:
        key = (key + word + 1) * _GOLDEN & _MASK
        key = (key ^ key >> 30) * 0xBF58476D1CE4E5B9 & _MASK
        key = (key ^ key >> 27) * 0x94D049BB133111EB & _MASK
        key ^= key >> 31
    return key


def _allocate(writer: _Writer, order: list[int], root: int) -> Tape:
    """Give each value a register, free again after its last use. An operand's register is never the destination's."""
    last_use = _last_uses(writer, order, root)
    code = np.full((len(order), 4), -1, np.int32)
    numbers = np.zeros((len(order), op.NUMBERS), np.float64)
    keys = np.zeros((len(order), 3), np.uint32)
    register: dict[int, int] = {}
    free: list[int] = []
    used = 0
    for at, place in enumerate(order):
        step = writer.steps[place]
        register[place] = free.pop() if free else used
        used = max(used, register[place] + 1)
        code[at] = step.op, register[place], register.get(step.a, -1), register.get(step.b, -1)
        numbers[at, : len(step.numbers)] = step.numbers
        keys[at] = step.keys
        free.extend(register[operand] for operand in {step.a, step.b} - {-1} if last_use[operand] == at)
    if used > REGISTERS_MAX:
        raise BadRecipe(f"recipe needs {used} registers; the limit is {REGISTERS_MAX}", registers=used)
    return Tape(code, numbers, keys, writer.needs_y.count(False), used, register[root])


def _last_uses(writer: _Writer, order: list[int], root: int) -> dict[int, int]:
    """Return where on the tape each value is read last. The root, and what planes read of columns, live to the end."""
    last_use: dict[int, int] = {}
    for at, place in enumerate(order):
        for operand in (writer.steps[place].a, writer.steps[place].b):
            if operand >= 0:
                crosses = writer.needs_y[place] and not writer.needs_y[operand]
                last_use[operand] = len(order) if crosses else max(at, last_use.get(operand, at))
    last_use[root] = len(order)
    return last_use
