"""The built-ins, and what a user may give as a recipe."""

import json

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import BUILTINS, RECIPE_DEFAULT, WorldRecipe, builtin, canonical

ARTICLE = {
    "op": "max",
    "a": {
        "op": "subtract",
        "a": {"op": "y"},
        "b": {"op": "multiply", "a": {"op": "fbm2", "frequency": 0.02, "octaves": 5}, "b": 24},
    },
    "b": {
        "op": "multiply",
        "a": {"op": "subtract", "a": {"op": "simplex3", "frequency": 0.05}, "b": 0.6},
        "b": 6,
    },
}


def test_terrain_is_the_field_of_the_contract():
    assert builtin("terrain") == canonical(ARTICLE)
    assert builtin("hills") == canonical(ARTICLE["a"])
    assert builtin("caves") == canonical(ARTICLE["b"])
    assert builtin("plane") == canonical({"op": "y"})
    assert builtin("sphere") == canonical({"op": "sphere", "radius": 48})


def test_the_built_ins_are_those_of_the_contract():
    assert list(BUILTINS)[:6] == ["terrain", "hills", "sphere", "plane", "caves", "planet"]
    assert RECIPE_DEFAULT in BUILTINS


@pytest.mark.parametrize("name", BUILTINS)
def test_a_built_in_is_a_tree_that_a_user_could_have_posted(name):
    assert canonical(json.loads(builtin(name))) == builtin(name)
    assert len({WorldRecipe(0, builtin(name)).digest for name in BUILTINS}) == len(BUILTINS)


def test_what_a_user_may_give():
    assert canonical("planet") == canonical({"builtin": "planet"}) == builtin("planet")
    assert canonical({"builtin": "planet", "radius": 6400000}) == builtin("planet", radius=6.4e6)
    assert '"radius":6400000.0' in canonical({"builtin": "planet", "radius": 6400000})
    assert canonical({"builtin": "planet", "radius": 200}) == builtin("planet")
    assert canonical({"builtin": "terrain", "relief": 5}) != builtin("terrain")
    assert canonical({"op": "y"}) == builtin("plane")
    assert canonical(3) == canonical({"op": "constant", "value": 3})
    assert canonical(b'"planet"') == canonical(b'{"builtin": "planet"}') == builtin("planet")
    assert canonical(b'{"op": "y"}') == builtin("plane")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("teapot", "'teapot'; built in are"),
        ("", "built in are"),
        ({"builtin": 3}, "built in are"),
        ({"builtin": ["planet"]}, "built in are"),
        ({"builtin": "planet", "radius": -1}, "at radius: should be greater than or equal to"),
        ({"builtin": "planet", "radius": "1"}, "at radius: should be a valid number"),
        ({"builtin": "planet", "radius": True}, "at radius: should be a valid number"),
        ({"builtin": "planet", "radius": [1]}, "at radius: should be a valid number"),
        ({"builtin": "planet", "radius": 1e13}, "at radius: should be less than"),
        ({"builtin": "planet", "relief": float("inf")}, "at relief: "),
        ({"builtin": "planet", "radios": 1}, "no parameter 'radios'; it has ['radius', 'relief']"),
        ({"builtin": "plane", "name": 1}, "no parameter 'name'"),
        ({"builtin": "plane", "op": "y"}, "no parameter 'op'"),
        (None, "a node"),
        (b"plane", "not JSON"),
    ],
)
def test_what_is_none_of_that_is_refused(given, expected):
    with pytest.raises(BadRecipe) as caught:
        canonical(given)
    assert expected in caught.value.message


def test_a_refusal_does_not_quote_a_long_name():
    for given in ("n" * 10**6, {"builtin": "n" * 10**6}, {"builtin": "plane", "n" * 10**6: 1}):
        with pytest.raises(BadRecipe) as caught:
            canonical(given)
        assert len(caught.value.message) + len(str(caught.value.values)) < 1000
