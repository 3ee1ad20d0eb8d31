"""Registers: none is overwritten while it is needed, and each is used again when it is not."""

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.field import densities as densities_of
from chunkserver.field import ops, sample
from chunkserver.field.flatten import WRITERS
from chunkserver.field.points import densities_at, run_box
from chunkserver.field.tape import INPUTS, Tape, allocate
from chunkserver.field.writer import Frame, Writer
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from tests.unit.field.chunks import recipe

CAVES = {"op": "simplex3", "frequency": 0.05}
SIDE = 5


def binary(name: str, a: object, b: object) -> dict[str, object]:
    return {"op": name, "a": a, "b": b}


def tapes(tree: object, lod: int = 0) -> tuple[Tape, Tape]:
    """Return the tape of a recipe, and the same with a register for each step."""
    writer = Writer(7, lod, WRITERS)
    root = writer.write(recipe(tree).expression, Frame())
    return allocate(writer.steps, root), allocate(writer.steps, root, keep=True)


def densities(tape: Tape) -> NDArray[np.float32]:
    return run_box(tape, np.array([-7.0, 11.0, 2.0]), 3.0, (SIDE, SIDE, SIDE))


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


def test_both_tapes_have_the_same_instructions_in_the_same_order():
    tape, kept = tapes(builtin("canyon").encode())
    assert tape.order == kept.order
    assert np.array_equal(tape.code[:, ops.CODE], kept.code[:, ops.CODE])
    assert np.array_equal(tape.reads, kept.reads)


def test_what_planes_read_of_columns_is_listed():
    tape, _ = tapes(binary("max", binary("subtract", {"op": "y"}, {"op": "simplex2", "frequency": 0.1}), {"op": "x"}))
    read = {register for row in tape.code[tape.columns :].tolist() for register in row[ops.A : ops.C]}
    assert set(tape.shared_values.tolist()) == {row[ops.OUT] for row in tape.code[: tape.columns].tolist()} & read
    assert tape.shared_places.tolist() == []


@pytest.mark.parametrize(
    ("frame", "in_rows"),
    [
        ({"op": "translate", "offset": [1.5, 2, -3]}, True),
        ({"op": "scale", "factor": [2, 3, 0.5]}, True),
        ({"op": "repeat", "period": [9, 0, 30]}, True),
        ({"op": "rotate", "quaternion": [1, 0, 0, 2]}, True),
        ({"op": "rotate", "quaternion": [0, 1, 0, 2]}, False),
        ({"op": "rotate", "quaternion": [0, 0, 1, 1]}, False),
        ({"op": "warp", "x": {"op": "x"}}, True),
        ({"op": "warp", "x": {"op": "y"}}, False),
        ({"op": "warp", "z": {"op": "add", "a": {"op": "y"}, "b": {"op": "z"}}}, True),
        ({"op": "warp", "z": {"op": "x"}}, False),
    ],
)
@pytest.mark.parametrize("noise", ["gradient3", "simplex3", "value3", "gradient2"])
def test_noise_is_of_rows_where_x_is_that_of_the_column_and_y_and_z_are_not(frame, in_rows, noise):
    tree = {**frame, "a": {"op": noise, "frequency": 0.1}}
    tape = check_registers(tree)
    (row,) = tape.code[tape.code[:, ops.CODE] >= ops.GRADIENT2]
    assert bool(row[ops.IN_ROWS]) is in_rows
    key, shape = ChunkKey(0, 1, -2, 3), ChunkShape(16)
    world = WorldRecipe(3, canonical(tree))
    low = np.array(key.low_corner(16)) - 1
    places = np.stack(np.meshgrid(*[np.arange(19.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:, [2, 0, 1]] + low
    assert densities_of(world, 0, places).tobytes() == sample(world, key, shape).density.tobytes()


SPHERE = {"op": "sphere", "radius": 4}
ROWS = {"op": "simplex3", "frequency": 0.1}


@pytest.mark.parametrize(
    "tree",
    [
        {"op": "y"},
        binary("subtract", {"op": "y"}, ROWS),
        binary("subtract", ROWS, {"op": "y"}),
        {"op": "heightfield", "height": ROWS},
        binary("max", ROWS, SPHERE),
        binary("max", ROWS, {"op": "cellular3", "frequency": 0.1}),
        binary("max", ROWS, {"op": "translate", "a": ROWS, "offset": [0, 3, 0]}),
        binary("max", ROWS, {"op": "rotate", "a": ROWS, "quaternion": [0, 0, 1, 1]}),
        binary("max", ROWS, {"op": "warp", "a": ROWS, "y": ROWS}),
    ],
)
@pytest.mark.parametrize("width", [SIDE, 19])
def test_y_is_there_wherever_it_is_read(tree, width):
    tape, _ = tapes(tree)
    low = np.array([-7.0, 11.0, 2.0])
    y, z, x = np.meshgrid(*(np.arange(n) + at for n, at in ((3, 11), (4, 2), (width, -7))), indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)
    assert run_box(tape, low, 1.0, (3, 4, width)).tobytes() == densities_at(tape, 1.0, points).tobytes()
