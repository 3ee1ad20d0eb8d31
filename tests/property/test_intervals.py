"""Bounds of a tape over a box hold for every register at every point of it; and a wrong bound would be noticed."""

import itertools
import math
import operator
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from chunkserver.errors import BadRecipe
from chunkserver.field import ops, prove, sample
from chunkserver.field.flatten import flatten
from chunkserver.field.intervals import ALL_FINITE, Bounds, bounds
from chunkserver.field.points import run_at
from chunkserver.field.tape import Tape
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import LATTICE_MAX, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.recipe.nodes import SECTIONS
from chunkserver.wire import Placement, encode
from tests.property.trees import Tree, keys, seeds, trees, trees_of
from tests.scale import count

SHAPE = ChunkShape(16)
OPS = [op for models in SECTIONS.values() for model in models for op in model.facts]

Grid = tuple[tuple[float, float, float], float, tuple[int, int, int]]
"""Points: the first one, the step between them, and how many there are along x, y, z."""


def kept_tape(tree: Tree, seed: int = 7, lod: int = 0) -> Tape:
    try:
        return flatten(WorldRecipe(seed, canonical(tree)), lod).kept
    except BadRecipe as error:
        assume("not finite" not in error.message)
        raise


def values_over(tape: Tape, grid: Grid) -> NDArray[np.float32]:
    """Return the value of each register at all points of a grid: (registers, points)."""
    low, step, counts = grid
    along = [at + step * np.arange(count) for at, count in zip(low, counts, strict=True)]
    points = np.stack(np.meshgrid(*along, indexing="ij")).reshape(3, -1)
    places = np.empty((1, tape.places, points.shape[1]))
    values = np.empty((1, tape.values, points.shape[1]), np.float32)
    places[0, :3] = points
    run_at(tape, places, values)
    found: NDArray[np.float32] = values[0]
    return found


def bounds_over(tape: Tape, grid: Grid, reach: float = 0.0) -> Bounds:
    low, step, counts = grid
    high = [at + step * (count - 1) for at, count in zip(low, counts, strict=True)]
    return bounds(tape, np.array([low]).T, np.array([high]).T, reach)


def holds(tape: Tape, bounded: Tape, grid: Grid) -> bool:
    """Whether the bounds of the tape `bounded` hold what `tape` gives, register by register."""
    found, values = bounds_over(bounded, grid), values_over(tape, grid)
    assert found.failed[0] == ALL_FINITE
    written = tape.code[tape.code[:, ops.CODE] > ops.COORDINATE_LAST, ops.OUT]
    return bool(((found.low <= values) & (values <= found.high))[written].all())


def spreads(tape: Tape, bounded: Tape, grid: Grid) -> bool:
    """Whether no register of `tape` changes by more, between neighbours of a grid, than `bounded` says."""
    found, values = bounds_over(bounded, grid, grid[1]), values_over(tape, grid)
    assert found.failed[0] == ALL_FINITE
    cube = values.reshape(-1, *grid[2]).astype(np.float64)
    written = tape.code[tape.code[:, ops.CODE] > ops.COORDINATE_LAST, ops.OUT]
    for offset in itertools.product((0, 1), (0, 1, -1), (0, 1, -1)):
        here = cube[:, *(slice(max(-by, 0), count - max(by, 0)) for by, count in zip(offset, grid[2], strict=True))]
        there = cube[:, *(slice(max(by, 0), count - max(-by, 0)) for by, count in zip(offset, grid[2], strict=True))]
        change = np.abs(here - there).reshape(len(cube), -1).max(axis=1, initial=0)
        if not (change <= found.spread[:, 0])[written].all():
            return False
    return True


def near_or_far(far: float) -> st.SearchStrategy[float]:
    return st.integers(-50, 50).map(float) | st.floats(-50, 50) | st.floats(-far, far)


grids: st.SearchStrategy[Grid] = st.tuples(
    st.tuples(*[near_or_far(LATTICE_MAX)] * 3),
    st.sampled_from([2.0**-10, 0.1, 1.0, 1.0, 1.0, 3.0, 2.0**5, 2.0**20, 2.0**36]),
    st.tuples(*[st.sampled_from([1, 2, 5, 9, 19])] * 3),
)
lods = st.integers(0, 6)


@settings(max_examples=count(20_000), deadline=None)
@given(trees, seeds, lods, grids)
def test_the_bounds_of_a_recipe_hold(tree, seed, lod, grid):
    tape = kept_tape(tree, seed, lod)
    assert holds(tape, tape, grid)
    assert spreads(tape, tape, grid)


@pytest.mark.parametrize("op", OPS)
@settings(max_examples=count(2_000), deadline=None)
@given(data=st.data())
def test_the_bounds_of_each_node_hold(op, data):
    tape, grid = kept_tape(data.draw(trees_of(op)), data.draw(seeds), data.draw(lods)), data.draw(grids)
    assert holds(tape, tape, grid)
    assert spreads(tape, tape, grid)


def with_numbers(tape: Tape, op: int, at: int, change: Callable[[float], float]) -> Tape:
    """Return the tape with one number of its first instruction `op` changed."""
    (row,) = np.nonzero(tape.code[:, ops.CODE] == op)[0][:1]
    numbers = tape.numbers.copy()
    place = tape.code[row, ops.NUMBERS] + at
    numbers[place] = change(numbers[place])
    return replace(tape, numbers=numbers)


def with_op(tape: Tape, op: int, other: int) -> Tape:
    """Return the tape with `other` in the place of every instruction `op`."""
    code = tape.code.copy()
    code[code[:, ops.CODE] == op, ops.CODE] = other
    return replace(tape, code=code)


X, Y, Z = ({"op": axis} for axis in "xyz")
XY = {"a": X, "b": Y}
NOISE = {"op": "value2", "frequency": 0.3}
FINE = {"op": "simplex3", "frequency": 2.0**-6}
BALL = {"op": "sphere", "radius": 4}
CUBE: Grid = (-9.0, -9.0, -9.0), 1.0, (19, 19, 19)
ASIDE: Grid = (3.0, -9.0, 1.0), 1.0, (19, 19, 19)
BESIDE: Grid = (-9.0, -9.0, -9.0), 1.0, (11, 2, 2)
CELLS = {"op": "repeat", "a": {"op": "random"}}
MOVED = {"op": "add", "a": {"op": "multiply", "a": {"op": "add", "a": X, "b": 3}, "b": -2}, "b": 7}
TWICE = partial(operator.mul, 2.0)
HALF = partial(operator.mul, 0.5)

WRONG_NUMBERS: dict[str, tuple[Tree, Grid, int, int, Callable[[float], float]]] = {
    "the range of noise is too narrow": (NOISE, CUBE, ops.VALUE2, ops.NOISE_HIGH, HALF),
    "noise is too flat": (FINE, ASIDE, ops.SIMPLEX3, ops.NOISE_LIPSCHITZ, partial(operator.mul, 0.1)),
    "the amplitude of noise": ({**NOISE, "op": "fbm2", "octaves": 2}, CUBE, ops.GRADIENT2, 0, HALF),
    "the depth of a shape": (BALL, CUBE, ops.SPHERE, 1, HALF),
    "the lift of a shape": ({"op": "cylinder", "radius": 4, "half_height": 3}, CUBE, ops.CYLINDER, 0, lambda _: 1.0),
    "a constant": (3, CUBE, ops.CONSTANT, 0, TWICE),
    "the factor of a coordinate": ({"op": "scale", "a": X, "factor": 2}, ASIDE, ops.AFFINE, 0, HALF),
    "the offset of a coordinate": ({"op": "translate", "a": X, "offset": [1, 0, 0]}, CUBE, ops.AFFINE, 1, TWICE),
    "the turn of a coordinate": ({"op": "rotate", "a": X, "quaternion": [0, 1, 0, 2]}, CUBE, ops.TURN, 2, HALF),
    "a period": ({"op": "repeat", "a": X, "period": [8, 0, 0]}, CUBE, ops.REPEAT, 0, HALF),
    "the cell of a period": ({**CELLS, "period": [4, 0, 0]}, BESIDE, ops.CELL, 1, lambda _: 0.0),
    "the middle of a blend": ({"op": "select", "by": X, "below": Y, "above": 99}, CUBE, ops.SELECT, 1, lambda _: -50.0),
    "the radius of a smooth minimum": ({"op": "smooth_min", **XY, "radius": 3}, CUBE, ops.SMOOTH_MIN, 1, lambda _: 0.0),
    "the radius of a smooth maximum": ({"op": "smooth_max", **XY, "radius": 3}, CUBE, ops.SMOOTH_MAX, 1, lambda _: 0.0),
    "a knot in between": ({"op": "remap", "a": X, "points": [[-5, 0], [0, 9], [5, 0]]}, CUBE, ops.REMAP, 6, HALF),
    "the rise to a knot": ({"op": "remap", "a": X, "points": [[-5, 0], [50, 9]]}, CUBE, ops.REMAP, 3, HALF),
    "how a ridge folds": ({**NOISE, "op": "ridged2", "octaves": 1}, CUBE, ops.FOLD, 1, HALF),
    "what is added first": (MOVED, CUBE, ops.LINEAR, 0, TWICE),
    "the factor": (MOVED, CUBE, ops.LINEAR, 1, HALF),
    "the sign of the factor": (MOVED, CUBE, ops.LINEAR, 1, operator.neg),
    "what is added last": (MOVED, CUBE, ops.LINEAR, 2, TWICE),
}


def check_planted(tree: Tree, grid: Grid, plant: Callable[[Tape], Tape]) -> None:
    tape = kept_tape(tree)
    assert holds(tape, tape, grid)
    assert not holds(tape, plant(tape), grid)


@pytest.mark.parametrize("wrong", WRONG_NUMBERS)
def test_a_wrong_bound_is_noticed(wrong):
    tree, grid, op, at, change = WRONG_NUMBERS[wrong]
    check_planted(tree, grid, lambda tape: with_numbers(tape, op, at, change))


WRONG_OPS: dict[str, tuple[Tree, Grid, int, int]] = {
    "add": ({"op": "add", "a": X, "b": Z}, ASIDE, ops.ADD, ops.SUBTRACT),
    "subtract": ({"op": "subtract", "a": {"op": "abs", "a": X}, "b": Z}, ASIDE, ops.SUBTRACT, ops.ADD),
    "above": ({"op": "subtract", "a": X, "b": Z}, ASIDE, ops.ABOVE, ops.COORDINATE),
    "multiply": ({"op": "multiply", **XY}, CUBE, ops.MULTIPLY, ops.MIN),
    "min": ({"op": "min", **XY}, ASIDE, ops.MIN, ops.MAX),
    "max": ({"op": "max", **XY}, ASIDE, ops.MAX, ops.MIN),
    "abs": ({"op": "abs", "a": X}, CUBE, ops.ABS, ops.CONSTANT),
    "coordinate": ({"op": "add", "a": X, "b": 1}, CUBE, ops.COORDINATE, ops.CONSTANT),
    "heightfield": ({"op": "heightfield", "height": X}, CUBE, ops.HEIGHT, ops.COORDINATE),
    "warp": ({"op": "warp", "a": X, "x": Y}, CUBE, ops.WARP, ops.REPEAT),
    "random": ({"op": "repeat", "a": {"op": "random"}, "period": [4, 0, 0]}, CUBE, ops.RANDOM, ops.CONSTANT),
}


@pytest.mark.parametrize("wrong", WRONG_OPS)
def test_the_bound_of_another_op_is_noticed(wrong):
    tree, grid, op, other = WRONG_OPS[wrong]
    check_planted(tree, grid, lambda tape: with_op(tape, op, other))


NEAR: Grid = (-9.0, -9.0, -9.0), 0.25, (9, 9, 9)
RAMP = {"op": "select", "by": X, "below": 0, "above": 9, "at": -9, "width": 4}
STEEP: dict[str, tuple[Tree, Grid, int, int, Callable[[float], float]]] = {
    "noise is too flat": ({**FINE, "frequency": 0.5}, NEAR, ops.SIMPLEX3, ops.NOISE_LIPSCHITZ, lambda _: 0.2),
    "the factor of a coordinate": ({"op": "scale", "a": X, "factor": 0.25}, NEAR, ops.AFFINE, 0, HALF),
    "the turn of a coordinate": ({"op": "rotate", "a": X, "quaternion": [0, 1, 0, 2]}, NEAR, ops.TURN, 2, HALF),
    "how steep a blend is": (RAMP, NEAR, ops.SELECT, 2, partial(operator.mul, 0.1)),
    "how a ridge folds": ({**FINE, "op": "ridged3", "frequency": 0.5, "octaves": 1}, NEAR, ops.FOLD, 1, HALF),
    "the rise of a piece": ({"op": "remap", "a": X, "points": [[-10, 0], [50, 9]]}, NEAR, ops.REMAP, 3, HALF),
    "the factor": (MOVED, NEAR, ops.LINEAR, 1, HALF),
}


@pytest.mark.parametrize("wrong", STEEP)
def test_a_wrong_spread_is_noticed(wrong):
    tree, grid, op, at, change = STEEP[wrong]
    tape = kept_tape(tree)
    assert spreads(tape, tape, grid)
    assert not spreads(tape, with_numbers(tape, op, at, change), grid)


SLOW: dict[str, tuple[Tree, int, int]] = {
    "add": ({"op": "add", "a": X, "b": X}, ops.ADD, ops.MAX),
    "multiply": ({"op": "multiply", **XY}, ops.MULTIPLY, ops.MIN),
    "heightfield": ({"op": "heightfield", "height": {"op": "multiply", "a": X, "b": -3}}, ops.HEIGHT, ops.COORDINATE),
    "above": ({"op": "subtract", "a": Y, "b": {"op": "multiply", "a": X, "b": -3}}, ops.ABOVE, ops.COORDINATE),
    "a distance": ({"op": "sphere", "radius": 4, "center": [90, 0, 0]}, ops.SPHERE, ops.CONSTANT),
}


@pytest.mark.parametrize("wrong", SLOW)
def test_the_spread_of_another_op_is_noticed(wrong):
    tree, op, other = SLOW[wrong]
    tape = kept_tape(tree)
    assert spreads(tape, tape, NEAR)
    assert not spreads(tape, with_op(tape, op, other), NEAR)


HUGE = 2.0**40
FAR_CORNER = HUGE / 2
AT_ORIGIN: Grid = (-2.0, -2.0, -2.0), 1.0, (5, 5, 5)
EDGE = float(LATTICE_MAX)
FAR_CELLS: Tree = {"op": "scale", "a": {"op": "cellular3", "frequency": 0.7}, "factor": 2**-8}


@pytest.mark.parametrize(
    ("tree", "grid"),
    [
        # The next number after 2^24 in float32 is 2 larger: on it the curve is past a knot that is 1/8 away.
        (
            {"op": "remap", "a": X, "points": [[2**24, 0], [2**24 + 0.125, 9], [2**24 + 64, 0]]},
            ((2.0**24, 0, 0), 2.0, (9, 1, 1)),
        ),
        # A sphere as large as the world whose surface is at the origin, where coordinates are small.
        ({"op": "sphere", "center": [FAR_CORNER] * 3, "radius": FAR_CORNER * 3**0.5}, AT_ORIGIN),
        ({"op": "capsule", "a": [-HUGE, -HUGE, HUGE], "b": [HUGE, HUGE, 1 - HUGE], "radius": 0.5}, AT_ORIGIN),
        ({"op": "plane", "normal": [1, 1, 1], "offset": HUGE}, ((HUGE, HUGE / 2, HUGE / 4), 1.0, (5, 5, 5))),
        ({"op": "torus", "center": [HUGE, 0, 0], "radius": HUGE, "tube": 1}, AT_ORIGIN),
        # A distance, as steep as it can be, where float64 has steps of 1/22 lattice cell.
        (FAR_CELLS, ((EDGE, EDGE, EDGE), 2.0**-12, (5, 5, 5))),
        ({**FAR_CELLS, "a": {**FAR_CELLS["a"], "op": "cellular2"}}, ((EDGE, 0, EDGE), 2.0**-12, (5, 5, 5))),
        # A factor between the two least numbers that float32 has.
        ({"op": "multiply", "a": {"op": "add", "a": X, "b": 0.4}, "b": 1e-45}, ((-20, 0, 0), 1.0, (41, 1, 1))),
        # In the middle of a faded shape the distance is 0, and not a rounding below.
        ({"op": "box", "half_extents": [0.9, 1.7, 2], "rounding": 0.3}, AT_ORIGIN),
    ],
)
def test_bounds_hold_where_rounding_is_hard(tree, grid):
    for lod in (0, 3):
        tape = kept_tape(tree, 7, lod)
        assert holds(tape, tape, grid)
        assert spreads(tape, tape, grid)


@pytest.mark.parametrize("angle", [0.3, 0.7, 1.1, 1.2866, 1.5])
def test_spreads_hold_where_a_turned_coordinate_is_small_and_far_out(angle):
    turned: Tree = {"op": "rotate", "a": Y, "quaternion": [0, 0, math.sin(angle / 2), math.cos(angle / 2)]}
    x, y = 2.0**38 * math.cos(angle), 2.0**38 * math.sin(angle)
    tape = kept_tape({"op": "subtract", "a": turned, "b": 1.43})
    assert spreads(tape, tape, ((float(round(y)), float(round(-x)), 0.0), 1.0, (7, 7, 3)))
    assert spreads(tape, tape, ((float(round(x)), float(round(y)), 0.0), 1.0, (7, 7, 3)))


@settings(max_examples=count(20_000), deadline=None)
@given(trees, seeds, keys)
def test_what_is_proven_is_what_is_sampled(tree, seed, key):
    kept_tape(tree, seed, key.lod)
    recipe = WorldRecipe(seed, canonical(tree))
    proven = prove(recipe, key, SHAPE)
    rock = sample(recipe, key, SHAPE).density < 0
    assert proven in {None, "rock" if rock.all() else None if rock.any() else "air"}


@pytest.mark.parametrize("name", BUILTINS)
def test_a_proven_chunk_has_the_bytes_of_a_sampled_one(name):
    """And most of a column of chunks is proven where a recipe has ground."""
    recipe, proven = WorldRecipe(7, builtin(name)), []
    for y in range(-12, 12):
        request = ChunkRequest(recipe, ChunkKey(y % 3, 1, y, -2), 16)
        proven.append(prove(recipe, request.key, SHAPE))
        mesh = extract(sample(recipe, request.key, SHAPE))
        chunk = build_chunk(request)
        assert chunk.content == mesh.content
        placement = Placement(request.key, 16, 1.0, geometric_error=geometric_error(recipe, request.key.lod))
        assert chunk.body == encode(mesh, placement, request.encoding)
        assert proven[-1] in {None, mesh.content}
    assert name == "caves" or any(proven)


def test_a_point_is_bounded_tightly():
    """A box of one point has one value, but for the slack."""
    for tree in (NOISE, FINE, BALL, {"op": "repeat", "a": {"op": "random"}, "period": [8, 8, 8]}):
        tape = kept_tape(tree)
        found = bounds_over(tape, ((1.0, 2.0, 3.0), 1.0, (1, 1, 1)))
        assert found.high[tape.result, 0] - found.low[tape.result, 0] < 1e-4
        assert found.spread[tape.result, 0] < 1e-4
