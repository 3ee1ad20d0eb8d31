"""A sample depends on its lattice point alone: whichever chunk asks, the bits are the same."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.field import sample
from chunkserver.grid import LATTICE_MAX, ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from tests.scale import TORTURE

SEED = 7
RECIPES = list(BUILTINS) if TORTURE else ["terrain", "planet"]


def density(recipe: str, key: ChunkKey, cells: int) -> NDArray[np.float32]:
    return sample(WorldRecipe(SEED, builtin(recipe)), key, ChunkShape(cells)).density


def shared(low: NDArray[np.float32], high: NDArray[np.float32], axis: int, cells: int) -> bool:
    """Whether two chunks, neighbours along an axis (x, y, z), hold the same bits in the three layers both have."""
    place = {0: 2, 1: 0, 2: 1}[axis]
    last = np.take(low, range(cells, cells + 3), place)
    first = np.take(high, range(3), place)
    return last.tobytes() == first.tobytes()


def far(cells: int, lod: int = 0) -> int:
    """Return the largest chunk coordinate of the world."""
    return LATTICE_MAX // (cells << lod) - 1


@pytest.mark.parametrize("cells", [16, 32, 64])
@pytest.mark.parametrize("recipe", RECIPES)
def test_neighbours_share_their_samples(recipe, cells):
    """Near, negative, across zero, around the 32-bit wrap of noise cells, and at both limits of the world."""
    wrap = 2**32 * 20 // cells
    for x, y, z in [(0, -1, 0), (-1, -1, -1), (-7, 2, 5), (wrap, -1, -wrap), (-far(cells) - 1, 0, far(cells) - 1)]:
        here = density(recipe, ChunkKey(0, x, y, z), cells)
        for axis in range(3):
            there = [x, y, z]
            there[axis] += 1
            assert shared(here, density(recipe, ChunkKey(0, *there), cells), axis, cells), (x, y, z, axis)


@pytest.mark.parametrize("lod", [1, 3, 7, 20])
def test_neighbours_share_their_samples_at_every_level(lod):
    for x, y, z in [(0, -1, 0), (-1, -1, -1), (far(32, lod) - 1, -far(32, lod), 3)]:
        here = density("planet", ChunkKey(lod, x, y, z), 32)
        for axis in range(3):
            there = [x, y, z]
            there[axis] += 1
            if there[axis] <= far(32, lod):
                assert shared(here, density("planet", ChunkKey(lod, *there), 32), axis, 32)


@pytest.mark.parametrize("recipe", ["plane", "sphere"])
@pytest.mark.parametrize("key", [ChunkKey(1, 0, -1, 0), ChunkKey(1, -3, 2, -1), ChunkKey(4, 2**20, -5, -(2**20))])
def test_a_coarse_sample_is_the_fine_one_where_nothing_fades(recipe, key):
    """Every second sample of the eight children, and nothing else, is the parent's."""
    cells = 16
    coarse = density(recipe, key, cells)[1:-1, 1:-1, 1:-1]
    half = cells // 2
    for a, b, c in itertools.product((0, 1), repeat=3):
        child = ChunkKey(key.lod - 1, 2 * key.x + a, 2 * key.y + b, 2 * key.z + c)
        fine = density(recipe, child, cells)[1:-1:2, 1:-1:2, 1:-1:2]
        part = coarse[b * half : (b + 1) * half + 1, c * half : (c + 1) * half + 1, a * half : (a + 1) * half + 1]
        assert fine.tobytes() == part.tobytes()


def test_a_sample_does_not_depend_on_the_size_of_its_chunk():
    """The chunk of 64 cells at the origin against the eight of 32 that fill it."""
    whole = density("terrain", ChunkKey(0, 0, -1, 0), 64)
    for a, b, c in itertools.product((0, 1), repeat=3):
        part = density("terrain", ChunkKey(0, a, b - 2, c), 32)
        assert part.tobytes() == whole[32 * b : 32 * b + 35, 32 * c : 32 * c + 35, 32 * a : 32 * a + 35].tobytes()
