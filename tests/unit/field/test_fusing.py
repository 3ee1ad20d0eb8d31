"""Steps that are fused: the same bits in fewer passes."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from numpy.typing import NDArray

from chunkserver.errors import BadRecipe
from chunkserver.field import ops
from chunkserver.field.flatten import WRITERS, flatten
from chunkserver.field.fusing import fused
from chunkserver.field.points import run_at
from chunkserver.field.tape import Tape, allocate
from chunkserver.field.writer import Frame, Writer
from tests.property.trees import Tree, trees
from tests.scale import count
from tests.unit.field.chunks import recipe

X, Y, Z = ({"op": axis} for axis in "xyz")
ABS = {"op": "abs", "a": X}
ZEROS = [0.0, -0.0, 1.0, -1.0, 0.5, 0.1, 1e-40, -1e-40, 3e7, -7.25]
"""Values, and constants: both zeros, what adding or subtracting makes zero, what it rounds, what is hardly a number."""


def tapes(tree: object) -> tuple[Tape, Tape]:
    """Return the tape of the steps as they are written, and that of the fused ones."""
    writer = Writer(7, 0, WRITERS)
    root = writer.write(recipe(tree).expression, Frame())
    return allocate(writer.steps, root), allocate(fused(writer.steps), root)


def values(tape: Tape, points: NDArray[np.float64]) -> bytes:
    """Return the values at points (3, n), not clamped."""
    places, found = np.empty((1, tape.places, points.shape[1])), np.empty((1, tape.values, points.shape[1]), np.float32)
    places[0, :3] = points
    run_at(tape, places, found)
    return bytes(found[0, tape.result])


def binary(name: str, a: object, b: object) -> dict[str, object]:
    return {"op": name, "a": a, "b": b}


@settings(max_examples=count(5_000), deadline=None)
@given(trees)
def test_a_recipe_has_the_same_bits(tree: Tree):
    try:
        flatten(recipe(tree), 0)
    except BadRecipe:
        assume(False)
    plain, fewer = tapes(tree)
    points = np.random.default_rng(1).uniform(-50, 50, (3, 64)).round(1)
    assert values(plain, points) == values(fewer, points)
    assert len(fewer.code) <= len(plain.code)


def chain(names: tuple[str, ...], constant: float, turned: bool) -> object:
    tree: object = X
    for place, name in enumerate(names):
        number = constant * (1 + place)
        tree = binary(name, number, tree) if turned else binary(name, tree, number)
    return tree


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    "names",
    [
        ("add",),
        ("subtract",),
        ("multiply",),
        ("add", "add"),
        ("subtract", "multiply"),
        ("multiply", "add"),
        ("multiply", "add", "subtract"),
        ("multiply", "subtract", "multiply"),
        ("add", "multiply", "add", "add"),
        ("subtract", "subtract", "subtract"),
    ],
)
def test_constants_change_no_bit_and_no_sign_of_a_zero(names, turned):
    points = np.array([ZEROS] * 3)
    for constant in ZEROS:
        plain, fewer = tapes(chain(names, constant, turned))
        assert values(plain, points) == values(fewer, points)


@pytest.mark.parametrize(
    ("tree", "expected"),
    [
        (binary("multiply", binary("subtract", ABS, 0.6), 6), [ops.LINEAR]),
        (binary("add", binary("multiply", binary("add", 3, ABS), 6), 5), [ops.LINEAR]),
        (binary("subtract", 5, binary("multiply", ABS, 6)), [ops.LINEAR] * 2),
        (binary("subtract", 5, binary("add", ABS, 6)), [ops.LINEAR]),
        (binary("multiply", binary("multiply", ABS, 0.1), 6), [ops.LINEAR] * 2),
        (binary("add", binary("add", binary("add", ABS, 1), 1), 1), [ops.LINEAR] * 2),
        (binary("subtract", Y, ABS), [ops.ABOVE]),
        (binary("subtract", ABS, Y), [ops.COORDINATE, ops.SUBTRACT]),
        (binary("subtract", ABS, binary("max", ABS, Z)), [ops.COORDINATE, ops.MAX, ops.SUBTRACT]),
    ],
)
def test_what_is_fused(tree, expected):
    _, tape = tapes(tree)
    assert tape.code[2:, ops.CODE].tolist() == expected


def test_what_others_read_stays():
    moved = binary("add", ABS, 3)
    plain, tape = tapes(binary("max", moved, binary("multiply", moved, 2)))
    assert tape.code[2:, ops.CODE].tolist() == [ops.LINEAR, ops.LINEAR, ops.MAX]
    points = np.array([ZEROS] * 3)
    assert values(plain, points) == values(tape, points)


def test_what_is_not_finite_is_refused_where_it_stands():
    """Not where it would be fused to."""
    huge = binary("multiply", binary("multiply", X, 2**40), 2**40)
    with pytest.raises(BadRecipe, match="at a: its value"):
        flatten(recipe(binary("add", binary("multiply", huge, 2**40), 5)), 0)
