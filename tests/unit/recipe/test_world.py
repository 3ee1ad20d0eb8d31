"""A world recipe: a seed and a canonical source, with a name for the source."""

import pickle

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import WorldRecipe, builtin, canonical, nodes


def test_the_digest_names_the_expression_and_not_the_seed():
    assert WorldRecipe(1, canonical(1)).digest == WorldRecipe(2, canonical(1.0)).digest
    assert WorldRecipe(1, canonical(1)).digest != WorldRecipe(1, canonical(2)).digest


def test_the_digest_is_the_same_for_ever():
    """A changed digest is a changed name of every stored world: raise RECIPE_VERSION on purpose, never by accident."""
    assert WorldRecipe(0, builtin("plane")).digest == "fab6e55cc8da8c23367f3ba410706d14"


def test_a_recipe_is_a_value():
    recipe = WorldRecipe(-5, builtin("terrain"))
    assert pickle.loads(pickle.dumps(recipe)) == recipe
    assert {recipe: 1}[WorldRecipe(-5, builtin("terrain"))] == 1
    assert isinstance(recipe.expression, nodes.Binary)
    with pytest.raises(AttributeError):
        setattr(recipe, "seed", 3)  # noqa: B010 - the type checker knows it too


@pytest.mark.parametrize("seed", [-(2**63), 2**63 - 1, 0])
def test_seeds_are_signed_64_bit(seed):
    assert WorldRecipe(seed, builtin("plane")).seed == seed


@pytest.mark.parametrize("seed", [-(2**63) - 1, 2**63, 10**100])
def test_other_seeds_are_refused(seed):
    with pytest.raises(BadRecipe, match="seed"):
        WorldRecipe(seed, builtin("plane"))


def test_a_source_that_is_no_recipe_is_refused_when_it_is_read():
    with pytest.raises(BadRecipe, match="at radius"):
        _ = WorldRecipe(0, '{"op":"sphere","radius":-1}').expression
