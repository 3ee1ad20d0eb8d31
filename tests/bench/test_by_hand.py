"""The functions that a tape is measured against write the same bits: otherwise it would be other work."""

import numpy as np
import pytest

from benchmarks import hand_solids, hand_terrain
from benchmarks.growth import NODES, shapes
from benchmarks.scenes import AROUND, SHAPE, layers
from chunkserver.field import sample
from chunkserver.grid import LATTICE_MAX, ChunkKey
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.recipe.node import Node

LAST = LATTICE_MAX // SHAPE.cells - 1
FAR = (
    ChunkKey(0, LAST, -LAST, LAST),
    ChunkKey(0, -LAST - 1, 2, 1 << 20),
    ChunkKey(0, 3, 4000, -1),
    ChunkKey(0, 1 << 31, -(1 << 31), 7),
)
"""At the ends of the world, and where the clamp of the density is reached."""


def count(node: Node) -> int:
    return 1 + sum(count(child) for _, child in node.children())


def same_bits(ours, by_hand) -> None:
    assert by_hand.dtype == np.float32
    assert np.array_equal(ours.view(np.uint32), np.ascontiguousarray(by_hand).view(np.uint32))


@pytest.mark.parametrize("seed", [42, -1, (1 << 63) - 1])
def test_terrain(seed):
    recipe, by_hand = WorldRecipe(seed, builtin("terrain")), hand_terrain.terrain(seed)
    for key in (*layers((-3, -1, 0), 4), *FAR):
        same_bits(sample(recipe, key, SHAPE).density, by_hand(key))


def test_terrain_where_the_low_word_of_a_cell_overflows():
    """A lattice cell of caves is 20 voxels: at 20 * 2**32 of them the low word of its number starts again."""
    recipe, by_hand = WorldRecipe(5, builtin("terrain")), hand_terrain.terrain(5)
    wraps = 20 * 2**32 // SHAPE.cells
    for offset in range(-2, 3):
        key = ChunkKey(0, wraps + offset, -1, -wraps + offset)
        same_bits(sample(recipe, key, SHAPE).density, by_hand(key))


def test_solids():
    recipe = WorldRecipe(0, canonical(hand_solids.recipe()))
    blocks = [sample(recipe, key, SHAPE).density for key in (*AROUND, *FAR)]
    for key, density in zip((*AROUND, *FAR), blocks, strict=True):
        same_bits(density, hand_solids.solids(key))
    assert sum(density.min() < 0 <= density.max() for density in blocks) > len(AROUND) // 3, "they are mostly empty"


def test_recipes_have_as_many_nodes_as_they_say():
    assert count(hand_solids.recipe()) == 50
    assert [count(shapes(nodes)) for nodes in NODES] == list(NODES)
