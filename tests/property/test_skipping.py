"""Samples that are not worked out matter to no byte: meshes are the same, whatever they are filled with."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from chunkserver.errors import BadRecipe
from chunkserver.field import patches, sample, sample_near_surface, skipping
from chunkserver.field.flatten import flatten
from chunkserver.grid import MASK_MAX, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.samples import Samples
from tests.property.trees import keys, seeds, trees
from tests.scale import count

FILLS = 1.0, 3e4
STEP = {"op": "heightfield", "height": 0.3}
SLAB = {"op": "box", "half_extents": [500, 500, 5], "center": [0, 0, 10.3]}
ISLAND = ChunkKey(0, 1, -2, 0)
CAVES = {"op": "multiply", "a": 6, "b": {"op": "subtract", "a": {"op": "simplex3", "frequency": 0.08}, "b": 0.4}}
GROUND = {"op": "heightfield", "height": {"op": "fbm2", "frequency": 0.03, "octaves": 4}}
BALL = {"op": "sphere", "radius": 14, "center": [3, 2, 5]}


@pytest.fixture(autouse=True)
def whatever_it_costs(monkeypatch):
    """Skip wherever anything can be skipped."""
    monkeypatch.setattr(skipping, "SETTLED_MIN", 0.0)


def near(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Samples:
    """Return what is sampled near the surface, whether that is worth it for this recipe or not."""
    whole = sample(recipe, key, shape, coarser)
    low = np.array(key.low_corner(shape.cells), np.float64) - shape.apron * key.step
    box = low, float(key.step), shape.samples, shape.apron, coarser
    density = skipping.run_near_surface(flatten(recipe, key.lod), *box)
    return Samples(shape, density, coarser, whole.coarse)


def faults(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> list[str]:
    """Return what differs from the chunk of which every sample was worked out."""
    whole = sample(recipe, key, shape, coarser)
    few = near(recipe, key, shape, coarser)
    found = []
    if ((few.density < 0) != (whole.density < 0)).any():
        found.append("signs")
    worked_out = np.abs(few.density) != skipping.FILL
    if few.density[worked_out].tobytes() != whole.density[worked_out].tobytes():
        found.append("values")
    one, other = extract(few), extract(whole)
    if any(a.tobytes() != b.tobytes() for a, b in zip(arrays(one), arrays(other), strict=True)):
        found.append("mesh")
    return found


def arrays(mesh):
    return mesh.positions, mesh.normals, mesh.triangles


def share(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape) -> float:
    """Return how many of a chunk's samples are worked out."""
    return float((np.abs(near(recipe, key, shape).density) != skipping.FILL).mean())


@pytest.mark.parametrize("fill", FILLS)
@pytest.mark.parametrize("name", BUILTINS)
def test_meshes_of_built_in_recipes_are_the_same(name, fill, monkeypatch):
    monkeypatch.setattr(skipping, "FILL", np.float32(fill))
    recipe = WorldRecipe(11, builtin(name))
    for key in (ChunkKey(0, 0, 0, 0), ChunkKey(0, 2, -1, 1), ChunkKey(0, -1, 5, 0), ChunkKey(2, -1, 0, 1)):
        for cells in (16, 32):
            assert not faults(recipe, key, ChunkShape(cells))
    assert not faults(recipe, ChunkKey(1, 0, -1, 0), ChunkShape(64))
    for mask in (1, 20, 42, 63):
        assert not faults(recipe, ChunkKey(0, 1, -1, 2), ChunkShape(32), mask)


@settings(max_examples=count(10_000), deadline=None)
@given(trees, seeds, keys, st.integers(0, MASK_MAX))
def test_meshes_of_any_recipe_are_the_same(tree, seed, key, mask):
    recipe = WorldRecipe(seed, canonical(tree))
    try:
        flatten(recipe, key.lod)
        flatten(recipe, key.lod + 1)
    except BadRecipe:
        assume(False)
    assert not faults(recipe, key, ChunkShape(16), mask)


@pytest.mark.parametrize("op", ["min", "max", "smooth_min", "smooth_max", "select"])
@pytest.mark.parametrize("lod", [0, 2])
def test_branches_that_cannot_show_change_nothing(op, lod):
    by = {"by": {"op": "x"}, "width": 3} if op == "select" else {}
    names = ("below", "above") if op == "select" else ("a", "b")
    radius = {"radius": 2} if op.startswith("smooth") else {}
    for a, b in ((GROUND, CAVES), (CAVES, GROUND), (BALL, GROUND), (CAVES, BALL)):
        recipe = WorldRecipe(5, canonical({"op": op, names[0]: a, names[1]: b, **by, **radius}))
        for y in (-2, -1, 0, 1):
            assert not faults(recipe, ChunkKey(lod, 0, y, -1), ChunkShape(32))


def test_a_surface_between_patches_that_are_all_settled():
    """No patch is worked out but those that are read."""
    assert not faults(
        WorldRecipe(0, canonical({"op": "heightfield", "height": 0.5})), ChunkKey(0, 0, 0, 0), ChunkShape(16)
    )


@pytest.mark.parametrize("lod", [0, 3])
def test_a_field_of_the_least_numbers_that_there_are(lod):
    for factor in (1e-45, 4e-45):
        tree = {"op": "multiply", "a": {"op": "subtract", "a": {"op": "x"}, "b": 0.4}, "b": factor}
        assert not faults(WorldRecipe(1, canonical(tree)), ChunkKey(lod, 0, 0, 0), ChunkShape(16))


def test_a_chunk_of_64_cells_between_coarser_neighbours():
    for mask in (2, 8, 32, 63):
        assert not faults(WorldRecipe(42, canonical(SLAB)), ChunkKey(0, 0, 0, 0), ChunkShape(64), mask)


def test_an_apron_of_two_samples():
    for middle in (10.3, 28.6):
        recipe = WorldRecipe(42, canonical({**SLAB, "center": [0, 0, middle]}))
        for mask in (8, 32, 40, 63):
            assert not faults(recipe, ChunkKey(0, 0, 0, 0), ChunkShape(32, 2), mask)


def test_more_programs_than_there_is_room_for():
    """Forty balls, of which each region needs other ones."""
    balls = [{"op": "sphere", "radius": 4, "center": [7 * n % 33, 11 * n % 34, 5 * n % 31]} for n in range(40)]
    union = balls[0]
    for ball in balls[1:]:
        union = {"op": "min", "a": union, "b": ball}
    for key in (ChunkKey(0, 0, 0, 0), ChunkKey(0, -1, 0, 0)):
        for cells in (32, 64):
            assert not faults(WorldRecipe(1, canonical(union)), key, ChunkShape(cells))


def test_samples_far_from_the_surface_are_not_worked_out():
    assert share(WorldRecipe(42, builtin("hills")), ChunkKey(0, 0, 0, 0), ChunkShape(32)) < 0.4
    assert share(WorldRecipe(42, canonical(BALL)), ChunkKey(0, 0, 0, 0), ChunkShape(32)) < 0.6


def test_a_cheap_recipe_is_sampled_whole():
    recipe, key, shape = WorldRecipe(42, builtin("hills")), ChunkKey(0, 0, 0, 0), ChunkShape(16)
    assert sample_near_surface(recipe, key, shape).density.tobytes() == sample(recipe, key, shape).density.tobytes()
    costly, key = WorldRecipe(42, builtin("city")), ChunkKey(0, -4, -1, 0)
    assert sample_near_surface(costly, key, shape).density.tobytes() != sample(costly, key, shape).density.tobytes()


def test_a_patch_that_is_read_and_missed_is_noticed(monkeypatch):
    monkeypatch.setattr("chunkserver.field.skipping.miss", lambda *_: 0)
    assert "mesh" in faults(WorldRecipe(0, canonical(STEP)), ChunkKey(0, 0, 0, 0), ChunkShape(16))


def test_a_spread_that_is_too_small_is_noticed(monkeypatch):
    monkeypatch.setattr("chunkserver.field.skipping.REACH", patches.REACH * 0.2)
    assert "signs" in faults(WorldRecipe(42, canonical(CAVES)), ChunkKey(0, 0, 6, 0), ChunkShape(32))


def test_a_face_before_a_coarser_neighbour_that_is_not_worked_out_is_noticed(monkeypatch):
    settle = patches.settle

    def without_faces(kinds, spread, middles, _faces, *rest):
        settle(kinds, spread, middles, 0, *rest)

    monkeypatch.setattr("chunkserver.field.skipping.settle", without_faces)
    assert "mesh" in faults(WorldRecipe(42, canonical(SLAB)), ChunkKey(0, 0, 0, 0), ChunkShape(32), 63)
