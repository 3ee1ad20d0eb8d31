"""Random recipes: the tape against a plain evaluator of the tree, bit for bit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from chunkserver.errors import BadRecipe
from chunkserver.field import sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, canonical
from chunkserver.recipe.nodes import SECTIONS
from tests.property.trees import INNER, LEAVES, Tree, keys, leaves, seeds, trees, trees_of
from tests.reference.field_twin import density
from tests.scale import count

SHAPE = ChunkShape(16)
OPS = [op for models in SECTIONS.values() for model in models for op in model.facts]


def whole(tree: Tree) -> Tree:
    """Return the tree plus 0: no level leaves an operand of it out, for that is done below `min` and `max` only."""
    return {"op": "add", "a": tree, "b": 0}


def sampled(tree: Tree, seed: int, key: ChunkKey) -> NDArray[np.float32]:
    """Return the samples of a chunk. What is not finite all over the world is another test's."""
    recipe = WorldRecipe(seed, canonical(tree))
    try:
        return sample(recipe, key, SHAPE).density
    except BadRecipe as error:
        assume("not finite" not in error.message)
        raise


def check(tree: Tree, seed: int, key: ChunkKey, places: list[tuple[int, int, int]]) -> None:
    got = sampled(whole(tree), seed, key)
    expression = WorldRecipe(seed, canonical(tree)).expression
    low = key.low_corner(SHAPE.cells)
    for place in places:
        point = [np.float64(low[axis] + key.step * (place[axis] - SHAPE.apron)) for axis in range(3)]
        with np.errstate(all="ignore"):
            assert got[place[1], place[2], place[0]] == density(expression, seed, key.lod, point)


places = st.lists(st.tuples(*[st.integers(0, SHAPE.samples - 1)] * 3), min_size=4, max_size=4)


def test_every_node_is_drawn():
    assert {*LEAVES, *INNER} == set(OPS)


@settings(max_examples=count(10_000), deadline=None)
@given(trees, seeds, keys, places)
def test_the_tape_gives_the_value_of_the_tree(tree, seed, key, places):
    check(tree, seed, key, places)


@pytest.mark.parametrize("op", OPS)
@settings(max_examples=count(1_000), deadline=None)
@given(data=st.data())
def test_the_tape_gives_the_value_of_each_node(op, data):
    check(data.draw(trees_of(op)), data.draw(seeds), data.draw(keys), data.draw(places))


@settings(max_examples=count(5_000), deadline=None)
@given(
    st.sampled_from(["min", "max"]).flatmap(
        lambda op: st.builds(lambda a, b: {"op": op, "a": a, "b": b}, trees, trees)
    ),
    seeds,
    keys,
)
def test_what_a_level_leaves_out_changes_no_sign(tree, seed, key):
    assert np.array_equal(sampled(tree, seed, key) < 0, sampled(whole(tree), seed, key) < 0)


@settings(deadline=None)
@given(trees)
def test_canonical_json_is_a_fixed_point(tree):
    source = canonical(tree)
    assert canonical(WorldRecipe(0, source).expression) == source


FIELDS = ["op", "a", "b", "by", "height", "value", "radius", "center", "frequency", "points", "period", "factor"]
anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda below: st.lists(below, max_size=4) | st.dictionaries(st.sampled_from(FIELDS), below, max_size=5),
    max_leaves=12,
)
nearly = st.recursive(
    leaves | anything,
    lambda below: (
        st.fixed_dictionaries({"op": st.sampled_from([*OPS, "q"]), "a": below, "b": below})
        | st.sampled_from(sorted(INNER)).flatmap(lambda op: INNER[op](below))
    ),
    max_leaves=6,
)


@settings(deadline=None)
@given(anything | nearly)
def test_anything_else_is_refused_by_name(tree):
    refusal = None
    try:
        source = canonical(tree)
    except BadRecipe as error:
        refusal = error.message
    if refusal is None:
        assert canonical(WorldRecipe(0, source).expression) == source
    else:
        assert refusal.startswith("recipe")
        assert len(refusal) < 2000


def spoiled(tree: Tree, draw: Callable[[Any], str]) -> tuple[Tree, list[str]]:
    """Return a tree with one value of one of its nodes made a string that none takes, and the path to it."""
    if not isinstance(tree, dict) or len(tree) == 1:
        return "no", []
    name = draw(st.sampled_from(sorted(tree.keys() - {"op"})))
    below, path = spoiled(tree[name], draw) if isinstance(tree[name], dict) else ("no", [])
    return {**tree, name: below}, [name, *path]


@settings(deadline=None)
@given(trees, st.data())
def test_one_wrong_value_is_refused_by_its_path(tree, data):
    bad, path = spoiled({"op": "abs", "a": tree}, data.draw)
    with pytest.raises(BadRecipe) as caught:
        canonical(bad)
    assert caught.value.values["path"] == ".".join(path)
