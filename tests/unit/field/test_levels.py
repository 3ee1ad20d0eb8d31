"""The fade rule: whole from 8 steps, gone at 4, nothing at LOD 0; and what has faded leaves no trace."""

import math

import pytest

from chunkserver.field import levels, sample
from chunkserver.field.levels import bounds, visible, weight
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, nodes


@pytest.mark.parametrize(
    ("size", "lod", "expected"),
    [
        (0.001, 0, 1.0),
        (16.0, 1, 1.0),
        (15.0, 1, 0.875),
        (12.0, 1, 0.5),
        (8.0, 1, 0.0),
        (7.9, 1, 0.0),
        (20.0, 2, 0.25),
        (2.0**23, 20, 1.0),
        (2.0**22, 20, 0.0),
    ],
)
def test_a_feature_is_whole_from_eight_steps_and_gone_at_four(size, lod, expected):
    assert weight(size, lod) == expected


def test_a_feature_never_grows_with_the_level():
    for size in (3.0, 20.0, 50.0, 1e6):
        weights = [weight(size, lod) for lod in range(21)]
        assert weights == sorted(weights, reverse=True)
        assert weights[0] == 1.0


ROUNDING = 1e-5

CAVE = nodes.Binary(op="subtract", a=nodes.Simplex3(frequency=0.05), b=nodes.Constant(value=0.6))
GROUND = nodes.Axis(op="y")
AIR_ABOVE_CAVE = nodes.Binary(op="subtract", a=nodes.Constant(value=0.0), b=CAVE)


def joined(op, a, b):
    return nodes.Binary(op=op, a=a, b=b)


@pytest.mark.parametrize(
    ("tree", "lod", "expected"),
    [
        (joined("max", GROUND, CAVE), 0, joined("max", GROUND, CAVE)),
        (joined("max", GROUND, CAVE), 1, joined("max", GROUND, CAVE)),
        (joined("max", GROUND, CAVE), 2, GROUND),
        (joined("max", CAVE, GROUND), 2, GROUND),
        (joined("min", GROUND, AIR_ABOVE_CAVE), 2, GROUND),
        (joined("min", GROUND, CAVE), 2, joined("min", GROUND, CAVE)),
        (joined("max", GROUND, AIR_ABOVE_CAVE), 2, joined("max", GROUND, AIR_ABOVE_CAVE)),
        (joined("min", joined("max", GROUND, CAVE), GROUND), 2, joined("min", GROUND, GROUND)),
        (joined("add", joined("max", GROUND, CAVE), GROUND), 2, joined("add", joined("max", GROUND, CAVE), GROUND)),
        (joined("max", CAVE, nodes.Constant(value=-1.0)), 2, CAVE),
        (nodes.Constant(value=-1.0), 2, nodes.Constant(value=-1.0)),
    ],
)
def test_a_cut_that_cuts_nothing_is_left_out(tree, lod, expected):
    assert visible(tree, lod) == expected


@pytest.mark.parametrize(
    ("op", "a", "b", "expected"),
    [
        ("add", (-1.0, 2.0), (10.0, 20.0), (9.0, 22.0)),
        ("subtract", (-1.0, 2.0), (10.0, 20.0), (-21.0, -8.0)),
        ("multiply", (-1.0, 2.0), (-10.0, 20.0), (-20.0, 40.0)),
        ("multiply", (-1.0, 2.0), (-math.inf, math.inf), (-math.inf, math.inf)),
        ("multiply", (0.0, 0.0), (-math.inf, math.inf), (0.0, 0.0)),
        ("min", (-1.0, 2.0), (0.0, 1.0), (-1.0, 1.0)),
        ("max", (-1.0, 2.0), (0.0, 1.0), (0.0, 2.0)),
    ],
)
def test_bounds_of_two(op, a, b, expected):
    assert levels._combined(op, a, b) == expected


@pytest.mark.parametrize("lod", [0, 1, 2, 3, 20])
@pytest.mark.parametrize("name", BUILTINS)
def test_bounds_hold_what_is_sampled(name, lod):
    recipe = WorldRecipe(3, builtin(name))
    low, high = bounds(visible(recipe.expression, lod), lod)
    for key in (ChunkKey(lod, 0, 0, 0), ChunkKey(lod, 1, -1, 2)):
        density = sample(recipe, key, ChunkShape(16)).density
        assert low - ROUNDING <= density.min()
        assert density.max() <= high + ROUNDING
