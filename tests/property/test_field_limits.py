"""Recipes with their numbers at the limits: refused by name, or as sound as any other."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chunkserver.errors import BadRecipe
from chunkserver.field import prove, sample
from chunkserver.field.flatten import flatten
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, canonical
from tests.property.test_intervals import grids, holds
from tests.property.trees import Tree, keys, seeds, trees
from tests.scale import count

SHAPE = ChunkShape(16)
LIMITS = [0.0, 1.0, 4.0, 16.0, 2.0**20, 2.0**40, 2.0**-20, 2.0**-40, 2.0**-149, 5e-324, 1 / 16, 1 - 2.0**-53]


def pushed(tree: Tree, draw: Any) -> Tree:
    """Return the tree with some of its numbers replaced by limits."""
    if isinstance(tree, dict):
        return {name: value if name == "op" else pushed(value, draw) for name, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [pushed(value, draw) for value in tree]
    if isinstance(tree, float) and draw(st.integers(0, 2)) == 0:
        return draw(st.sampled_from(LIMITS)) * draw(st.sampled_from([1.0, 1.0, -1.0]))
    return tree


@st.composite
def limits(draw: Any) -> Tree:
    return pushed(draw(trees), draw)


@settings(max_examples=count(20_000), deadline=None)
@given(limits(), seeds, keys, grids)
def test_limits_are_refused_by_name_or_sound(tree, seed, key, grid):
    refusal = kept = None
    try:
        recipe = WorldRecipe(seed, canonical(tree))
        kept = flatten(recipe, key.lod).kept
    except BadRecipe as error:
        refusal = error.message
    if kept is None:
        assert str(refusal).startswith("recipe")
        return
    assert holds(kept, kept, grid)
    proven = prove(recipe, key, SHAPE)
    air = sample(recipe, key, SHAPE).density >= 0
    assert proven is None or bool((air == (proven == "air")).all())


def test_a_plane_far_below_the_least_number_of_a_shape_is_bounded():
    """Scaled until its distances pass any number that could stand for minus infinity."""
    tree: Tree = {"op": "plane"}
    for _ in range(4):
        tree = {"op": "scale", "a": tree, "factor": 2.0**-20}
    far: Tree = 2.0**23
    for factor in (2.0**40, 2.0**40):
        tree, far = ({"op": "multiply", "a": part, "b": factor} for part in (tree, far))
    recipe = WorldRecipe(0, canonical({"op": "add", "a": tree, "b": far}))
    for key in (ChunkKey(20, 0, -1, 0), ChunkKey(19, 0, -1, 0), ChunkKey(19, 0, -2, 0)):
        proven = prove(recipe, key, SHAPE)
        air = sample(recipe, key, SHAPE).density >= 0
        assert proven is None or bool((air == (proven == "air")).all())


def test_a_recipe_is_finite_for_every_seed_or_for_none():
    steep: Tree = {"op": "scale", "a": {"op": "gradient3", "frequency": 2.0**-40}, "factor": 2.0**20}
    for factor in (2.0**40, 2.0**40, 2.0**28):
        steep = {"op": "multiply", "a": steep, "b": factor}
    for seed in range(20):
        with pytest.raises(BadRecipe, match="not finite"):
            flatten(WorldRecipe(seed, canonical(steep)), 0)
