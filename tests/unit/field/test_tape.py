"""Registers: none is overwritten while it is needed, and each is used again when it is not."""

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.flatten import WRITERS
from chunkserver.field.interpreter import run
from chunkserver.field.noise.lattice import scratch
from chunkserver.field.tape import INPUTS, Tape, allocate, keep_all
from chunkserver.field.writer import Frame, Writer
from chunkserver.recipe import BUILTINS, builtin
from tests.unit.field.chunks import recipe

CAVES = {"op": "simplex3", "frequency": 0.05}
SIDE = 5


def binary(name: str, a: object, b: object) -> dict[str, object]:
    return {"op": name, "a": a, "b": b}


def tapes(tree: object, lod: int = 0) -> tuple[Tape, Tape]:
    """Return the tape of a recipe, and the same with a register for each step."""
    writer = Writer(7, lod, WRITERS)
    root = writer.write(recipe(tree).expression, Frame())
    return allocate(writer.steps, root), keep_all(writer.steps, root)[0]


def densities(tape: Tape) -> NDArray[np.float32]:
    places, values = np.empty((tape.places, SIDE * SIDE)), np.empty((tape.values, SIDE * SIDE), np.float32)
    density = np.empty((SIDE, SIDE * SIDE), np.float32)
    low = np.array([-7.0, 11.0, 2.0])
    box = low, 3.0, SIDE
    run(tape.code, tape.numbers, tape.keys, tape.columns, tape.result, *box, places, values, *scratch(), density)
    return density


def check_registers(tree: object, lod: int = 0) -> Tape:
    tape, kept = tapes(tree, lod)
    assert np.array_equal(densities(tape), densities(kept))
    return tape


@pytest.mark.parametrize("name", BUILTINS)
@pytest.mark.parametrize("lod", [0, 2, 9])
def test_no_value_is_overwritten_before_its_last_use(name, lod):
    check_registers(builtin(name).encode(), lod)


def test_an_operands_register_is_never_the_destinations():
    tape = check_registers(
        binary("add", binary("multiply", {"op": "x"}, {"op": "y"}), binary("max", CAVES, {"op": "z"}))
    )
    for row in tape.code.tolist():
        read = [ops.X, ops.Y, ops.Z] if row[ops.CODE] <= ops.COORDINATE_LAST else [ops.A, ops.B]
        assert row[ops.OUT] not in [row[column] for column in read] or row[ops.CODE] in (ops.CONSTANT, ops.COORDINATE)


def test_registers_are_used_again():
    deep: object = {"op": "y"}
    for n in range(15):
        term = binary("multiply", {"op": "y"}, {**CAVES, "salt": n})
        deep = binary("add", deep, {"op": "translate", "a": term, "offset": [1, n, 0]})
    tape = check_registers(deep)
    assert len(tape.code) > 60
    assert tape.values <= 6
    assert tape.places <= INPUTS + 4


def test_columns_that_planes_read_live_to_the_end():
    columns: object = {"op": "y"}
    for n in range(8):
        columns = binary("add", columns, {"op": "simplex2", "frequency": 0.1, "salt": n})
    assert check_registers(columns).values > 8


def test_what_the_root_does_not_need_is_not_on_the_tape():
    writer = Writer(7, 0, WRITERS)
    frame = Frame()
    root = writer.constant(3.0, frame)
    writer.constant(4.0, frame)
    assert len(allocate(writer.steps, root).code) == 1
