"""Reading a recipe: one spelling for each, limits before work, and errors that name the path and what was expected."""

import json

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import nodes
from chunkserver.recipe.reading import (
    COST_MAX,
    DEPTH_MAX,
    NODES_MAX,
    SOURCE_BYTES_MAX,
    canonical_tree,
    parse,
    read_json,
)
from tests.worlds import total

Y = {"op": "y"}


def chain(depth: int) -> object:
    tree: object = Y
    for _ in range(depth):
        tree = {"op": "add", "a": tree, "b": Y}
    return tree


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.0),
        (1, {"op": "constant", "value": 1}),
        (-0.0, 0),
        ({"op": "constant", "value": -0.0}, 0.0),
        ({"op": "sphere", "radius": 3}, {"radius": 3.0, "center": [0, -0.0, 0], "op": "sphere"}),
        (
            {"op": "fbm2", "frequency": 0.5, "octaves": 1},
            {"op": "fbm2", "frequency": 0.5, "octaves": 1, "gain": 0.5, "salt": 0},
        ),
        (
            {"op": "fbm3", "frequency": 0.5, "octaves": 1},
            {"op": "fbm3", "frequency": 0.5, "octaves": 1, "noise": "simplex"},
        ),
        ({"op": "warp", "a": Y}, {"op": "warp", "a": Y, "x": 0, "y": {"op": "constant", "value": 0}, "z": -0.0}),
        ({"op": "scale", "a": Y, "factor": 2}, {"op": "scale", "a": Y, "factor": [2, 2.0, 2]}),
        ({"op": "add", "a": 1, "b": Y}, nodes.Binary(op="add", a=nodes.Constant(value=1.0), b=nodes.Axis(op="y"))),
    ],
)
def test_equal_recipes_have_one_canonical_json(one, other):
    assert canonical_tree(one) == canonical_tree(other)


@pytest.mark.parametrize(("one", "other"), [(1, 2), (1, -1), (Y, {"op": "x"}), (0.1, 0.1000000000000001)])
def test_different_recipes_have_different_canonical_json(one, other):
    assert canonical_tree(one) != canonical_tree(other)


def test_canonical_json_is_compact_sorted_and_complete():
    assert canonical_tree({"radius": 3, "op": "sphere"}) == '{"center":[0.0,0.0,0.0],"op":"sphere","radius":3.0}'


def nested(bad: object) -> object:
    return {"op": "max", "a": 1, "b": {"op": "min", "a": bad, "b": Y}}


@pytest.mark.parametrize(
    ("bad", "path", "expected"),
    [
        ({"op": "simplex3", "frequency": 3}, "frequency", "less than or equal to 1"),
        ({"op": "simplex3", "frequency": 0}, "frequency", "greater than or equal to"),
        ({"op": "simplex3", "frequency": 0.5, "salt": 2**32}, "salt", "less than 4294967296"),
        ({"op": "simplex3", "frequency": 0.5, "salt": 1.5}, "salt", "integer"),
        ({"op": "simplex3"}, "frequency", "should be there"),
        ({"op": "sphere", "radius": 0}, "radius", "greater than or equal to 0.00000095"),
        ({"op": "sphere", "radius": 1, "center": [0, 1]}, "center.2", "should be there"),
        ({"op": "sphere", "radius": 1, "center": [0, 1, "2"]}, "center.2", "number"),
        ({"op": "sphere", "radius": 1, "colour": 3}, "colour", "not a field"),
        ({"op": "fbm2", "frequency": 0.5, "octaves": 10**9}, "octaves", "less than or equal to 16"),
        ({"op": "fbm2", "frequency": 0.5, "octaves": 0}, "octaves", "greater than or equal to 1"),
        ({"op": "fbm2", "frequency": 0.5, "octaves": 3}, "", "frequency of the last octave"),
        ({"op": "fbm2", "frequency": 0.5, "octaves": 1, "gain": 0}, "gain", "greater than"),
        ({"op": "fbm2", "frequency": 0.5, "octaves": 1, "lacunarity": 0.5}, "lacunarity", "greater than"),
        ({"op": "box", "half_extents": [3, 4, 5], "rounding": 3.5}, "", "at most the smallest half extent"),
        ({"op": "plane", "normal": [0, 0, 0]}, "", "normal should have a component"),
        ({"op": "cellular3", "frequency": 0.5, "returns": "f1"}, "returns", "'distance', 'edge' or 'value'"),
        ({"op": "cellular3", "frequency": 0.5, "jitter": 1.5}, "jitter", "less than or equal to 1"),
        ({"op": "clamp", "a": Y, "low": 1, "high": 0}, "", "low should be at most high"),
        ({"op": "clamp", "a": Y, "low": {"op": "y"}, "high": 0}, "low", "number"),
        ({"op": "select", "by": Y, "below": Y}, "above", "should be there"),
        ({"op": "select", "by": Y, "below": Y, "above": Y, "width": -1}, "width", "greater than or equal to 0"),
        ({"op": "remap", "a": Y, "points": [[0, 1]]}, "points", "at least 2 items"),
        ({"op": "remap", "a": Y, "points": [[0, 1]] * 33}, "points", "at most 32 items"),
        ({"op": "remap", "a": Y, "points": [[0, 1], [0, 2]]}, "points", "should rise"),
        ({"op": "remap", "a": Y, "points": [[2**40, 1], [2**40, 2]]}, "points", "should rise"),
        ({"op": "remap", "a": Y, "points": [[-(2**40), 1], [-(2**40), 2]]}, "points", "should rise"),
        ({"op": "remap", "a": Y, "points": [[0, 1], [1, "2"]]}, "points.1.1", "number"),
        ({"op": "scale", "a": Y, "factor": 0}, "factor", "greater than or equal to"),
        ({"op": "scale", "a": Y, "factor": [1, 2]}, "factor.2", "should be there"),
        ({"op": "scale", "a": Y, "factor": [1, 2, -3]}, "factor.2", "greater than or equal to"),
        ({"op": "rotate", "a": Y, "quaternion": [0, 0, 0, 0]}, "", "quaternion should have a component"),
        ({"op": "repeat", "a": Y, "period": [0, 0, 0]}, "period", "one of them not 0"),
        ({"op": "repeat", "a": Y, "period": [0, 3, 0]}, "period", "at least 4.0 voxels"),
        ({"op": "repeat", "a": Y, "period": [0, -8, 0]}, "period.1", "greater than or equal to 0"),
        ({"op": "warp", "a": Y, "w": 1}, "w", "not a field"),
        ({"op": "detail", "a": Y, "factor": 32}, "factor", "less than or equal to 16"),
        ({"op": "constant", "value": True}, "value", "number"),
        ({"op": "constant", "value": "1"}, "value", "number"),
        ({"op": "constant", "value": None}, "value", "number"),
        ({"op": "constant", "value": float("nan")}, "value", "finite"),
        ({"op": "constant", "value": float("-inf")}, "value", ""),
        ({"op": "constant", "value": 1.1e12}, "value", "less than or equal to 1099511627776"),
        ({"op": "constant", "value": 10**300}, "value", "less than or equal to 1099511627776"),
        ({"op": "teapot"}, "", "one of 'constant', 'x'"),
        ({"op": ["x"]}, "", "known op"),
        ({"a": 1}, "", "have an op"),
        ({}, "", "have an op"),
        (True, "", "a node (an object with an op) or a number"),
        (None, "", "a node"),
        ("y", "", "a node"),
        ([Y], "", "a node"),
        (float("nan"), "", "finite"),
        (-1e300, "", "greater than or equal to -1099511627776"),
        ({"op": "x", "x": 1}, "x", "not a field"),
    ],
)
@pytest.mark.parametrize("deep", [False, True], ids=["root", "deep"])
def test_an_error_names_the_path_and_what_was_expected(bad, path, expected, deep):
    with pytest.raises(BadRecipe) as caught:
        canonical_tree(nested(bad) if deep else bad)
    where = ".".join(part for part in ("b.a" if deep else "", path) if part)
    assert caught.value.values["path"] == where
    assert caught.value.message.startswith(f"recipe: at {where or 'the root'}: ")
    assert expected in caught.value.message


def test_an_error_does_not_quote_a_long_input():
    for bad in ({"op": "y" * 10**6}, {"op": "y", "k" * 10**6: 1}, {"op": "constant", "value": "9" * 10**6}):
        with pytest.raises(BadRecipe) as caught:
            canonical_tree(bad)
        assert len(caught.value.message) + len(str(caught.value.values)) < 2000


def test_the_deepest_and_the_largest_recipes_are_read_back():
    for tree in (chain(DEPTH_MAX - 1), total([Y] * (NODES_MAX // 2))):
        source = canonical_tree(tree)
        assert canonical_tree(parse(source)) == source


def test_recipes_past_a_limit_are_refused():
    with pytest.raises(BadRecipe, match=f"deeper than {DEPTH_MAX}"):
        canonical_tree(chain(DEPTH_MAX))
    with pytest.raises(BadRecipe, match=f"larger than {NODES_MAX}"):
        canonical_tree(total([Y] * (NODES_MAX // 2 + 1)))
    constants: object = Y
    for _ in range(DEPTH_MAX - 1):
        constants = {"op": "add", "a": constants, "b": 1}
    with pytest.raises(BadRecipe, match="larger"):
        canonical_tree({"op": "sphere", "radius": 1, "center": [0] * 9000})
    assert canonical_tree(constants)


CELLS = {"op": "cellular3", "frequency": 0.1}


@pytest.mark.parametrize(
    ("tree", "path"),
    [
        ({"op": "warp", "a": Y, "y": total([{"op": "fbm3", "frequency": 2.0**-20, "octaves": 16}] * 200)}, "y."),
        (total([CELLS] * 300), ""),
        (
            {"op": "detail", "factor": 1, "a": total([{"op": "ridged2", "frequency": 2.0**-20, "octaves": 16}] * 300)},
            "a.",
        ),
    ],
)
def test_a_recipe_that_costs_too_much_is_refused_by_the_node_that_passes_the_limit(tree, path):
    with pytest.raises(BadRecipe, match=f"more than {COST_MAX:.0f} ns a sample") as caught:
        canonical_tree(tree)
    assert str(caught.value.values["path"]).startswith(path)
    assert str(caught.value.values["path"]).split(".")[-1] in {"a", "b", "y"}
    assert float(str(caught.value.values["cost"])) > COST_MAX


def test_cost_is_the_sum_of_the_nodes():
    """One node less is within the limit, one more is past it."""
    each = parse(canonical_tree(CELLS)).cost() + parse(canonical_tree({"op": "add", "a": 0, "b": 0})).cost()
    fits = int(COST_MAX / each)
    assert canonical_tree(total([CELLS] * (fits - fits // 20)))
    with pytest.raises(BadRecipe, match="ns a sample"):
        canonical_tree(total([CELLS] * (fits + 2)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[" * 60_000, "nested deeper"),
        ('{"a":' * 10_000, "nested deeper"),
        ("[NaN]", "NaN"),
        ("-Infinity", "-Infinity"),
        ('{"op": "y"', "not JSON"),
        ("", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        ("9" * 5000, "not JSON"),
        (" " * SOURCE_BYTES_MAX + "1", "bytes"),
        (b"\xc3\xa9" * SOURCE_BYTES_MAX, "bytes"),
    ],
)
def test_text_that_is_no_recipe_is_refused(text, expected):
    with pytest.raises(BadRecipe, match=expected):
        read_json(text)


def test_text_is_read():
    assert read_json(json.dumps(Y)) == Y
    assert canonical_tree(read_json(b' {"op" : "y"} ')) == canonical_tree(Y)
