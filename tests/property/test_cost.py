"""No recipe takes longer to sample than its static cost says: that is what the limit on it is for.

Times are set against those of a recipe that is known, measured in turns with it, so the speed of the machine cancels.
"""

import time

import pytest
from hypothesis import HealthCheck, assume, given, settings

from chunkserver.errors import BadRecipe
from chunkserver.field import sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, canonical, nodes
from tests.property.trees import Tree, large_trees
from tests.scale import count
from tests.unit.recipe.trees import cost_of
from tests.worlds import total

RATIO_MAX = 3.0
TRIES = 6
"""Others on the machine make a time longer, never shorter: one try within the limit is enough."""
NANOSECONDS_MIN = 1e6
"""Shorter runs say more about calls than about samples."""
KEY, SHAPE = ChunkKey(0, 1, -1, 2), ChunkShape(32)
SAMPLES = SHAPE.samples**3
KNOWN = WorldRecipe(7, canonical({"op": "fbm3", "frequency": 0.001, "octaves": 8}))


def nanoseconds(recipe: WorldRecipe) -> float:
    began = time.thread_time_ns()
    sample(recipe, KEY, SHAPE)
    return time.thread_time_ns() - began


def ratio(recipe: WorldRecipe) -> float:
    """Return how much longer a recipe takes than its cost says, where the known one takes what its cost says."""
    times = [(nanoseconds(recipe), nanoseconds(KNOWN)) for _ in range(2)]
    taken, known = (min(column) for column in zip(*times, strict=True))
    return float(taken / cost_of(recipe.source) / (known / cost_of(KNOWN.source)))


def check(tree: Tree) -> None:
    recipe = WorldRecipe(7, canonical(tree))
    assert any(ratio(recipe) <= RATIO_MAX for _ in range(TRIES))


X, Y = {"op": "x"}, {"op": "y"}

HARD: dict[str, list[Tree]] = {
    "constants, each kept in a register": [{"op": "multiply", "a": Y, "b": n} for n in range(250)],
    "columns, each kept in a register": [{"op": "max", "a": Y, "b": {"op": "add", "a": X, "b": n}} for n in range(160)],
    "coordinates": [{"op": "rotate", "a": Y, "quaternion": [1, 2, 3, n]} for n in range(300)],
    "shapes": [{"op": "sphere", "radius": n + 1} for n in range(500)],
    "selections": [{"op": "select", "by": Y, "below": X, "above": n, "at": n} for n in range(200)],
    "knots": [{"op": "remap", "a": Y, "points": [[k, k * n % 7] for k in range(32)]} for n in range(60)],
    "cells of noise": [{"op": "cellular3", "frequency": 0.1, "salt": n, "returns": "value"} for n in range(60)],
}


@pytest.mark.parametrize("trees", HARD.values(), ids=HARD)
def test_what_is_hard_takes_no_longer_than_it_costs(trees):
    check(total(trees))


@settings(max_examples=count(2_000), deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(large_trees)
def test_no_recipe_takes_longer_than_it_costs(tree):
    try:
        taken = nanoseconds(WorldRecipe(7, canonical(tree)))
    except BadRecipe:
        assume(False)
    assume(taken >= NANOSECONDS_MIN)
    check(tree)


def test_a_cost_that_is_too_low_is_noticed(monkeypatch):
    monkeypatch.setattr(nodes.Cellular, "cost", lambda _: 1.0)
    recipe = WorldRecipe(7, canonical(total(HARD["cells of noise"][:8])))
    assert min(ratio(recipe) for _ in range(TRIES)) > RATIO_MAX
