"""Random recipes: the tape against a plain evaluator of the tree, bit for bit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from chunkserver.errors import BadRecipe
from chunkserver.field import sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, canonical
from tests.reference.field_twin import density
from tests.scale import count

SHAPE = ChunkShape(16)

numbers = st.floats(-1e4, 1e4, allow_nan=False)
frequencies = st.floats(2**-10, 1.0)
octaves = st.builds(
    lambda op, frequency, octaves, lacunarity, gain, salt: {
        "op": op,
        "frequency": frequency / lacunarity ** (octaves - 1) * 0.999,
        "octaves": octaves,
        "lacunarity": lacunarity,
        "gain": gain,
        "salt": salt,
    },
    st.sampled_from(["fbm2", "fbm3"]),
    frequencies,
    st.integers(1, 3),
    st.floats(1.0, 8.0),
    st.floats(0.01, 1.0),
    st.integers(0, 3),
)
leaves = st.one_of(
    numbers,
    st.sampled_from(["x", "y", "z"]).map(lambda op: {"op": op}),
    st.builds(lambda c, r: {"op": "sphere", "center": c, "radius": r}, st.tuples(*[numbers] * 3), st.floats(0.1, 1e4)),
    st.builds(lambda f, s: {"op": "simplex3", "frequency": f, "salt": s}, frequencies, st.integers(0, 3)),
    octaves,
)
trees = st.recursive(
    leaves,
    lambda below: st.builds(
        lambda op, a, b: {"op": op, "a": a, "b": b},
        st.sampled_from(["add", "subtract", "multiply", "min", "max"]),
        below,
        below,
    ),
    max_leaves=12,
)
keys = st.builds(
    ChunkKey,
    st.integers(0, 4),
    *[st.integers(-3, 3) | st.integers(-(2**31), 2**31)] * 3,
)


@settings(max_examples=count(6_000))
@given(trees, st.integers(-(2**63), 2**63 - 1), keys, st.data())
def test_the_tape_gives_the_value_of_the_tree(tree, seed, key, data):
    recipe = WorldRecipe(seed, canonical(tree))
    got = sample(recipe, key, SHAPE).density
    low = key.low_corner(SHAPE.cells)
    for _ in range(4):
        place = data.draw(st.tuples(*[st.integers(0, SHAPE.samples - 1)] * 3))
        point = [np.float64(low[axis] + key.step * (place[axis] - SHAPE.apron)) for axis in range(3)]
        with np.errstate(all="ignore"):
            expected = density(recipe.expression, seed, key.lod, point)
        assert got[place[1], place[2], place[0]] == expected


@given(trees)
def test_canonical_json_is_a_fixed_point(tree):
    source = canonical(tree)
    assert canonical(WorldRecipe(0, source).expression) == source


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda below: (
        st.lists(below, max_size=4)
        | st.dictionaries(
            st.sampled_from(["op", "a", "b", "value", "radius", "center", "frequency"]), below, max_size=5
        )
    ),
    max_leaves=12,
)
nearly = st.recursive(
    leaves | anything,
    lambda below: st.fixed_dictionaries(
        {"op": st.sampled_from(["add", "max", "sphere", "fbm2", "x", "q"]), "a": below, "b": below}
    ),
    max_leaves=6,
)


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
        assert len(refusal) < 1000
