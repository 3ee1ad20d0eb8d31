"""The worlds of the library: parameters, cost, and a density that is about the distance to the surface."""

import inspect
from itertools import product
from typing import Any

import numpy as np
import pytest

from chunkserver.errors import BadRecipe
from chunkserver.field import prove, sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from pages.levels import place_of
from tests.unit.recipe.trees import cost_of

WORLDS = ("islands", "canyon", "floating-islands", "arches", "moon", "city", "spires", "ring", "continents")
COST_MAX = 700.0
"""Nanoseconds a sample, each operand counted as often as it stands in the tree."""
JUMP_MAX = 6.0
"""Most that the density changes from a sample in rock to its neighbour in air. Cut off cells jump by far more."""
ASIDE = (6, 4, 6)
SHAPE = ChunkShape()

PARAMETERS = [(name, parameter) for name in WORLDS for parameter in inspect.signature(BUILTINS[name]).parameters]


def densities(name: str) -> np.ndarray:
    """Return the samples of the chunks around a world's place, (chunks, n, n, n), those without a surface left out."""
    recipe = WorldRecipe(42, builtin(name))
    low = [coordinate // SHAPE.cells - aside // 2 for coordinate, aside in zip(place_of(name), ASIDE, strict=True)]
    keys = [ChunkKey(0, *map(sum, zip(low, offset, strict=True))) for offset in product(*map(range, ASIDE))]
    found = [sample(recipe, key, SHAPE).density for key in keys if prove(recipe, key, SHAPE) is None]
    return np.array([density for density in found if (density < 0).any() and (density >= 0).any()])


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_says_what_it_is(name):
    line = str(BUILTINS[name].__doc__).split("\n\n")[0]
    assert line.endswith(".")
    assert len(line) < 100
    assert inspect.signature(BUILTINS[name]).parameters


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_cheap(name):
    assert 50 < cost_of(canonical(name)) < COST_MAX


@pytest.mark.parametrize("name", WORLDS)
def test_the_density_is_about_the_distance_to_the_surface(name):
    density = densities(name).astype(np.float64)
    assert len(density) > 4
    slope = np.linalg.norm(np.gradient(density, axis=(1, 2, 3)), axis=0)
    rises = [np.abs(np.diff(density, axis=axis)) for axis in (1, 2, 3)]
    crossed = [np.diff(density < 0, axis=axis) for axis in (1, 2, 3)]
    assert 0.5 < np.median(slope[:, :-1][crossed[0]]) < 2
    for rise, where in zip(rises, crossed, strict=True):
        assert rise[where].max() < JUMP_MAX


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_the_ends_of_a_parameter_are_worlds_too(name, parameter):
    schema = inspect.signature(BUILTINS[name]).parameters[parameter].annotation.__metadata__[0].metadata
    low, high = (next(getattr(bound, side) for bound in schema if hasattr(bound, side)) for side in ("ge", "le"))
    for value in (low, high):
        density = sample(WorldRecipe(0, builtin(name, **{parameter: value})), ChunkKey(0, 0, 0, 0), SHAPE).density
        assert np.isfinite(density).all()
    bad: tuple[Any, ...] = (low - 0.5, high + 1, -low, 0, True, "64", float("nan"))
    for value in bad:
        with pytest.raises(BadRecipe, match=f"at {parameter}: "):
            builtin(name, **{parameter: value})
