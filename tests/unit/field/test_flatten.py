"""What is on a recipe's tape at a level, what is left out, and which recipes are refused there."""

import json

import numpy as np
import pytest

from chunkserver.errors import BadRecipe
from chunkserver.field import (
    compiling,
    interpreter,
    intervals,
    ops,
    patches,
    prove,
    sample,
    sample_near_surface,
)
from chunkserver.field.flatten import flatten
from chunkserver.field.tape import REGISTERS_MAX, Tape
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from tests.unit.field.chunks import SHAPE, recipe
from tests.worlds import crowded

CAVES = {"op": "simplex3", "frequency": 0.05}
HILLS = {"op": "fbm2", "frequency": 0.02, "octaves": 5}
Y = {"op": "y"}


def tape_of(tree: object, lod: int = 0) -> Tape:
    return flatten(recipe(tree), lod).tape


def ops_of(tape: Tape) -> list[int]:
    return [int(code) for code in tape.code[:, ops.CODE]]


def binary(name: str, a: object, b: object) -> dict[str, object]:
    return {"op": name, "a": a, "b": b}


def test_equal_subtrees_are_on_the_tape_once():
    twice = binary("max", {"op": "abs", "a": CAVES}, binary("multiply", CAVES, {"op": "abs", "a": CAVES}))
    assert ops_of(tape_of(twice)).count(ops.SIMPLEX3) == 1
    assert ops_of(tape_of(twice)).count(ops.ABS) == 1


def test_equal_subtrees_of_different_places_are_kept_apart():
    moved = {"op": "translate", "a": CAVES, "offset": [1, 0, 0]}
    assert ops_of(tape_of(binary("max", CAVES, moved))).count(ops.SIMPLEX3) == 2
    again = binary("max", moved, {"op": "translate", "a": CAVES, "offset": [1, 0, -0.0]})
    assert ops_of(tape_of(again)).count(ops.SIMPLEX3) == 1


def test_subtrees_that_differ_in_a_salt_are_kept_apart():
    assert ops_of(tape_of(binary("max", CAVES, {**CAVES, "salt": 1}))).count(ops.SIMPLEX3) == 2


@pytest.mark.parametrize(
    ("tree", "value"),
    [
        (binary("multiply", binary("add", 0.1, 0.2), 3), np.float32(np.float32(0.1) + np.float32(0.2)) * np.float32(3)),
        ({"op": "clamp", "a": 9, "low": -1, "high": 4}, 4),
        ({"op": "select", "by": 0.25, "below": 0, "above": 1, "at": 0.5, "width": 1}, 0.15625),
        ({"op": "remap", "a": 0.5, "points": [[0, 10], [1, 30]]}, 20),
        ({"op": "smooth_min", "a": 1, "b": 1, "radius": 4}, 0),
        ({"op": "scale", "a": 3, "factor": [5, 2, 7]}, 6),
    ],
)
def test_constants_are_worked_out_once(tree, value):
    tape = tape_of(tree)
    assert ops_of(tape) == [ops.CONSTANT]
    assert tape.numbers[0] == value


def test_what_moves_nothing_is_not_on_the_tape():
    still = {"op": "translate", "a": CAVES, "offset": [0, 0, 0]}
    still = {
        "op": "rotate",
        "a": {"op": "warp", "a": {"op": "scale", "a": still, "factor": [2, 2, 1]}},
        "quaternion": [0, 0, 0, 2],
    }
    assert ops_of(tape_of(still)).count(ops.WARP) == 0
    assert ops_of(tape_of({"op": "translate", "a": Y, "offset": [0, 0, 0]})) == [ops.COORDINATE]


def test_what_does_not_depend_on_y_comes_first():
    tape = tape_of(binary("max", binary("subtract", Y, binary("multiply", HILLS, 24)), CAVES))
    above, below = ops_of(tape)[: tape.columns], ops_of(tape)[tape.columns :]
    assert above.count(ops.GRADIENT2) == 5
    assert ops.LINEAR in above
    assert set(below) == {ops.ABOVE, ops.SIMPLEX3, ops.MAX}


UPRIGHT = [0, 0.6, 0, 0.8]
FLAT_NOISE = {"op": "simplex2", "frequency": 0.05}


@pytest.mark.parametrize(
    "tree",
    [
        {"op": "x"},
        HILLS,
        3.5,
        {"op": "rotate", "a": FLAT_NOISE, "quaternion": UPRIGHT},
        {"op": "warp", "a": FLAT_NOISE, "x": HILLS, "z": 3},
        {"op": "warp", "a": FLAT_NOISE, "y": Y},
        {"op": "repeat", "a": binary("add", {"op": "x"}, {"op": "random"}), "period": [32, 0, 32]},
        {"op": "random"},
        {"op": "translate", "a": {"op": "scale", "a": FLAT_NOISE, "factor": [2, 3, 4]}, "offset": [1, 2, 3]},
    ],
)
def test_a_recipe_without_y_is_all_columns(tree):
    tape = tape_of(tree)
    assert tape.columns == len(tape.code)


def test_octaves_that_a_level_has_lost_are_not_on_the_tape():
    """Feature sizes 50, 25, 12.5, 6.25, 3.125 voxels; at LOD 2 what is at most 16 is gone, at LOD 4 everything."""
    assert [ops_of(tape_of(HILLS, lod)).count(ops.GRADIENT2) for lod in range(6)] == [5, 3, 2, 1, 0, 0]
    assert ops_of(tape_of(HILLS, 4)) == [ops.CONSTANT]
    for family in ("ridged2", "billow2"):
        assert [ops_of(tape_of({**HILLS, "op": family}, lod)).count(ops.GRADIENT2) for lod in range(5)] == [
            5,
            3,
            2,
            1,
            0,
        ]
        assert ops_of(tape_of({**HILLS, "op": family}, 4)) == [ops.CONSTANT]


def test_fading_octaves_keep_the_sum_of_the_whole_ones_as_their_measure():
    tape = tape_of(HILLS, 1)
    amplitudes = tape.numbers[tape.code[1:4, ops.NUMBERS]]
    assert np.allclose(amplitudes * 31 / 16, [1, 0.5, 0.25 * (6.25 - 4) / 4])


CAVE = binary("subtract", CAVES, 0.6)
AIR_ABOVE_CAVE = binary("subtract", 0, CAVE)
BALL = {"op": "sphere", "radius": 6}
DOMES = {"op": "repeat", "a": BALL, "period": [16, 0, 16]}


@pytest.mark.parametrize(
    ("tree", "lod", "expected"),
    [
        (binary("max", Y, CAVE), 2, Y),
        (binary("max", CAVE, Y), 2, Y),
        (binary("min", Y, AIR_ABOVE_CAVE), 2, Y),
        (binary("min", Y, BALL), 2, Y),
        (binary("min", BALL, Y), 2, Y),
        (binary("min", Y, DOMES), 2, Y),
        (binary("min", binary("max", Y, CAVE), {"op": "x"}), 2, binary("min", Y, {"op": "x"})),
        (
            {"op": "translate", "a": binary("max", Y, CAVE), "offset": [0, 9, 0]},
            2,
            {"op": "translate", "a": Y, "offset": [0, 9, 0]},
        ),
        ({"op": "clamp", "a": Y, "low": -3, "high": 8}, 1, Y),
        (binary("max", CAVE, -1), 2, CAVE),
        ({"op": "smooth_max", "a": Y, "b": CAVE, "radius": 0.25}, 2, Y),
        ({"op": "smooth_min", "a": AIR_ABOVE_CAVE, "b": Y, "radius": 0.25}, 2, Y),
    ],
)
def test_what_cannot_show_is_left_out(tree, lod, expected):
    same_tape(tape_of(tree, lod), tape_of(expected, lod))


@pytest.mark.parametrize(
    ("tree", "lod"),
    [
        (binary("max", Y, CAVE), 0),
        (binary("max", Y, CAVE), 1),
        (binary("max", Y, AIR_ABOVE_CAVE), 2),
        (binary("min", Y, CAVE), 2),
        (binary("min", Y, BALL), 1),
        (binary("add", binary("max", Y, CAVE), Y), 2),
        ({"op": "abs", "a": binary("max", Y, CAVE)}, 2),
        ({"op": "smooth_max", "a": Y, "b": CAVE, "radius": 1}, 2),
    ],
)
def test_what_shows_or_may_count_by_more_than_its_sign_is_kept(tree, lod):
    """All that is on the tape of the same plus 0, where the rule does not apply, but for that."""
    kept, whole = ops_of(tape_of(tree, lod)), ops_of(tape_of(binary("add", tree, 0), lod))
    assert sorted([*kept, ops.LINEAR]) == sorted(whole)


def same_tape(one: Tape, other: Tape) -> None:
    assert ops_of(one) == ops_of(other)
    assert np.array_equal(one.code, other.code)
    assert np.array_equal(one.numbers, other.numbers)
    assert np.array_equal(one.keys, other.keys)


def test_registers_that_pass_the_limit_are_refused():
    with pytest.raises(BadRecipe, match=f"limit is {REGISTERS_MAX}"):
        tape_of(crowded())


LARGE = 2.0**40
CUBE = binary("multiply", LARGE, binary("multiply", LARGE, LARGE))


@pytest.mark.parametrize(
    ("tree", "path"),
    [
        (binary("multiply", CUBE, LARGE), ""),
        (binary("max", Y, {"op": "abs", "a": binary("multiply", CUBE, {"op": "x"})}), "b.a"),
        (binary("multiply", binary("multiply", binary("multiply", Y, Y), Y), Y), ""),
        ({"op": "warp", "a": {"op": "simplex3", "frequency": 1}, "x": binary("multiply", Y, Y)}, "a"),
        (
            {"op": "warp", "a": {"op": "repeat", "a": {"op": "x"}, "period": [4, 0, 0]}, "x": binary("multiply", Y, Y)},
            "a",
        ),
        (
            {
                "op": "scale",
                "a": {"op": "scale", "a": {"op": "cellular3", "frequency": 1}, "factor": 2**-20},
                "factor": 1,
            },
            "a.a",
        ),
        ({"op": "select", "by": binary("multiply", CUBE, {"op": "x"}), "below": 0, "above": 1}, "by"),
    ],
)
def test_what_is_not_finite_all_over_the_world_is_refused_by_its_path(tree, path):
    for use in (sample, prove):
        with pytest.raises(BadRecipe) as caught:
            use(recipe(tree), ChunkKey(0, 0, 0, 0), SHAPE)
        assert caught.value.values["path"] == path
        assert caught.value.message.startswith(f"recipe: at {path or 'the root'}: ")
        assert "finite" in caught.value.message


@pytest.mark.parametrize(
    "tree",
    [
        CUBE,
        binary("multiply", Y, binary("multiply", Y, Y)),
        {
            "op": "scale",
            "a": {"op": "scale", "a": {"op": "simplex3", "frequency": 2.0**-20}, "factor": 2**-20},
            "factor": 1,
        },
    ],
)
def test_what_is_large_and_finite_is_not_refused(tree):
    assert np.isfinite(sample(recipe(tree), ChunkKey(0, 2**36 - 1, 2**36 - 1, -(2**36)), ChunkShape(16)).density).all()


def test_a_tape_is_flattened_once():
    terrain = WorldRecipe(7, builtin("terrain"))
    again = WorldRecipe(7, canonical(json.loads(builtin("terrain"))))
    assert flatten(terrain, 0) is flatten(again, 0)
    assert flatten(terrain, 0) is not flatten(terrain, 1)
    assert flatten(terrain, 0) is not flatten(WorldRecipe(8, terrain.source), 0)


def test_no_recipe_compiles_anything():
    """Whatever the recipe, it is the same code that runs: a first chunk waits for no compiler."""
    compiling.compile_beside()
    compiling.compile_interpreter()
    kernels = interpreter.run, intervals.bound, patches.judge, patches.list_work, patches.settle, patches.miss
    compiled = [len(getattr(kernel, "signatures")) for kernel in kernels]  # noqa: B009 - a type checker knows no kernel
    for name in BUILTINS:
        for lod in (0, 3):
            world = WorldRecipe(11, builtin(name))
            sample_near_surface(world, ChunkKey(lod, 0, -1, 0), SHAPE)
            prove(world, ChunkKey(lod, 0, -1, 0), SHAPE)
    assert [len(getattr(kernel, "signatures")) for kernel in kernels] == compiled == [1] * len(kernels)  # noqa: B009
