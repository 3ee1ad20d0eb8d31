"""The tape: what is on it, in which order, and that no register is overwritten while it is needed."""

import json

import numpy as np
import pytest

from chunkserver.errors import BadRecipe
from chunkserver.field import interpreter as op
from chunkserver.field.tape import REGISTERS_MAX, Tape, flatten, noise_name
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical

CAVES = {"op": "simplex3", "frequency": 0.05}
HILLS = {"op": "fbm2", "frequency": 0.02, "octaves": 5}


def tape_of(tree: object, lod: int = 0) -> Tape:
    return flatten(WorldRecipe(7, canonical(tree)), lod)


def ops(tape: Tape) -> list[int]:
    return [int(code) for code in tape.code[:, 0]]


def binary(name: str, a: object, b: object) -> dict[str, object]:
    return {"op": name, "a": a, "b": b}


def test_equal_subtrees_are_on_the_tape_once():
    twice = binary("max", binary("subtract", CAVES, 0.5), binary("multiply", CAVES, binary("subtract", CAVES, 0.5)))
    assert ops(tape_of(twice)).count(op.SIMPLEX3) == 1
    assert ops(tape_of(twice)).count(op.SUBTRACT) == 1


def test_subtrees_that_differ_in_a_salt_are_kept_apart():
    assert ops(tape_of(binary("max", CAVES, {**CAVES, "salt": 1}))).count(op.SIMPLEX3) == 2


def test_what_does_not_depend_on_y_comes_first():
    tape = tape_of(binary("max", binary("subtract", {"op": "y"}, binary("multiply", HILLS, 24)), CAVES))
    above, below = ops(tape)[: tape.columns], ops(tape)[tape.columns :]
    assert above.count(op.GRADIENT2) == 5
    assert op.MULTIPLY in above
    assert set(below) == {op.Y, op.SUBTRACT, op.SIMPLEX3, op.MAX}


@pytest.mark.parametrize("tree", [{"op": "x"}, HILLS, 3.5])
def test_a_recipe_without_y_is_all_columns(tree):
    tape = tape_of(tree)
    assert tape.columns == len(tape.code)


def test_octaves_that_a_level_has_lost_are_not_on_the_tape():
    """Feature sizes 50, 25, 12.5, 6.25, 3.125 voxels; at LOD 2 what is at most 16 is gone, at LOD 4 everything."""
    assert [ops(tape_of(HILLS, lod)).count(op.GRADIENT2) for lod in range(6)] == [5, 3, 2, 1, 0, 0]
    assert ops(tape_of(HILLS, 4)) == [op.CONSTANT]


def test_fading_octaves_keep_the_sum_of_the_whole_ones_as_their_measure():
    amplitudes = tape_of(HILLS, 1).numbers[1:4, 0]
    assert np.allclose(amplitudes * 31 / 16, [1, 0.5, 0.25 * (6.25 - 4) / 4])


@pytest.mark.parametrize("name", BUILTINS)
@pytest.mark.parametrize("lod", [0, 2, 9])
def test_no_value_is_overwritten_before_its_last_use(name, lod):
    check_registers(flatten(WorldRecipe(7, builtin(name)), lod))


def check_registers(tape: Tape) -> None:
    """Replay the tape as the interpreter does, twice over the planes, with the name of each value in its register."""
    held: dict[int, object] = {}
    planes = [range(len(tape.code)), range(tape.columns, len(tape.code)), range(tape.columns, len(tape.code))]
    expected: dict[int, tuple[object, object]] = {}
    for rows in planes:
        for at in rows:
            _, out, a, b = tape.code[at].tolist()
            assert out not in {a, b}, "an operand's register is never the destination's"
            assert out < tape.registers
            operands = held.get(a), held.get(b)
            assert expected.setdefault(at, operands) == operands, "every plane reads the values that the first one read"
            held[out] = at
        assert held[tape.result] == len(tape.code) - 1 or tape.columns == len(tape.code)


def test_registers_are_used_again():
    deep: object = {"op": "y"}
    for n in range(30):
        deep = binary("add", deep, binary("multiply", {"op": "y"}, {**CAVES, "salt": n}))
    tape = tape_of(deep)
    assert len(tape.code) > 90
    assert tape.registers <= 6
    check_registers(tape)


def test_a_recipe_that_needs_too_many_registers_is_refused():
    wide = [{"op": "constant", "value": n} for n in range(256)]
    while len(wide) > 1:
        wide = [
            binary("max", binary("multiply", {"op": "y"}, a), b) for a, b in zip(wide[::2], wide[1::2], strict=True)
        ]
    with pytest.raises(BadRecipe, match=f"limit is {REGISTERS_MAX}"):
        tape_of(wide[0])


def test_a_tape_is_flattened_once():
    recipe = WorldRecipe(7, builtin("terrain"))
    again = WorldRecipe(7, canonical(json.loads(builtin("terrain"))))
    assert flatten(recipe, 0) is flatten(again, 0)
    assert flatten(recipe, 0) is not flatten(recipe, 1)
    assert flatten(recipe, 0) is not flatten(WorldRecipe(8, recipe.source), 0)


def test_names_of_noises_differ_in_every_word():
    names = [(7, 0, 0), (8, 0, 0), (7, 1, 0), (7, 0, 1), (0, 7, 0), (0, 0, 7), (-7, 0, 0), (7 + 2**32, 0, 0), (0, 0, 0)]
    offsets = {offset for name in names for offset in noise_name(*name)[0]}
    keys = {key for name in names for key in noise_name(*name)[1]}
    assert len(offsets) == len(keys) == 3 * len(names)
    assert all(0 <= offset < 1 for offset in offsets)
    assert all(0 <= key < 2**32 for key in keys)
