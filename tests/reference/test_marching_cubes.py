"""The mesher against its slow twin: equal to the bit, but for the numbers of vertices and triangles."""

from itertools import product

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import POSITION_HIGH, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples
from tests.reference.marching_cubes import twin, unnumbered
from tests.scale import TORTURE, count
from tests.worlds import GRIDS, SMALLEST, white_noise


def assert_equals_twin(samples: Samples) -> None:
    mesh = extract(samples)
    assert unnumbered(mesh, extract(samples, normals="float32")) == twin(samples)


@pytest.mark.parametrize("kind", GRIDS)
def test_made_up_grids(kind, rng):
    for _ in range(count(300)):
        samples = Samples(SMALLEST, GRIDS[kind](rng, SMALLEST.samples))
        assert_equals_twin(samples)


@pytest.mark.parametrize(("cells", "kind"), list(product([32, 64], GRIDS)) if TORTURE else [(32, "smooth")])
def test_larger_chunks(cells, kind, rng):
    shape = ChunkShape(cells)
    assert_equals_twin(Samples(shape, GRIDS[kind](rng, shape.samples)))


def test_a_row_of_corners_longer_than_a_word():
    mesh = extract(hills := sample(WorldRecipe(1, builtin("hills")), ChunkKey(0, -1, -1, 0), ChunkShape(64)))
    assert mesh.positions[:, 0].max() == POSITION_HIGH
    assert_equals_twin(hills)


@pytest.mark.parametrize("apron", [2, 3])
def test_a_wider_apron_changes_nothing(apron, rng):
    shape = ChunkShape(16, apron)
    density = white_noise(rng, shape.samples)
    assert_equals_twin(Samples(shape, density))
    inner = slice(apron - 1, 1 - apron)
    narrow, wide = extract(Samples(SMALLEST, density[inner, inner, inner].copy())), extract(Samples(shape, density))
    for mine, theirs in (
        (narrow.positions, wide.positions),
        (narrow.normals, wide.normals),
        (narrow.triangles, wide.triangles),
    ):
        assert np.array_equal(mine, theirs)


@pytest.mark.parametrize("recipe", ["terrain", "caves", "planet"])
@pytest.mark.parametrize("key", [ChunkKey(0, -1, -1, 0), ChunkKey(3, 0, -1, -1)])
def test_worlds(recipe, key):
    assert_equals_twin(sample(WorldRecipe(-5, builtin(recipe)), key, SMALLEST))
