"""Transition cells against their slow twin, which goes through the cells in another order: the same triangles, to the
bit."""

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import ChunkKey
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples, coarse_box
from tests.reference.transitions import triangles_of, twin
from tests.scale import count
from tests.worlds import GRIDS, SMALLEST


def assert_equals_twin(samples: Samples) -> None:
    mesh, mesh_float32 = extract(samples), extract(samples, normals="float32")
    assert np.array_equal(mesh.positions, mesh_float32.positions)
    assert np.array_equal(mesh.triangles, mesh_float32.triangles)
    assert triangles_of(mesh, mesh_float32) == twin(samples)


@pytest.mark.parametrize("kind", GRIDS)
def test_made_up_grids(kind, rng):
    for mask in rng.permutation(np.arange(1, 64))[: count(63)].tolist():
        coarse = GRIDS[kind](rng, 11)
        planes, rows, width = coarse_box(16, mask).shape
        there = np.ascontiguousarray(coarse[:planes, :rows, :width])
        assert_equals_twin(Samples(SMALLEST, GRIDS[kind](rng, SMALLEST.samples), mask, there))


@pytest.mark.parametrize(("recipe", "mask"), [("terrain", 4), ("caves", 63), ("planet", 37)])
def test_worlds(recipe, mask):
    assert_equals_twin(sample(WorldRecipe(-5, builtin(recipe)), ChunkKey(1, 0, -1, -1), SMALLEST, mask))
