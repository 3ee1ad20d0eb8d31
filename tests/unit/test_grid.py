"""Chunk keys, chunk shapes and the limits of the world."""

import numpy as np
import pytest

from chunkserver.errors import BadKey, BadParameter
from chunkserver.grid import (
    CELLS_BUILT,
    LATTICE_MAX,
    LOD_MAX,
    POSITION_HIGH,
    POSITION_LOW,
    ChunkKey,
    ChunkShape,
    check_key,
    check_shape,
    coarser_mask,
)
from tests.octrees import random_octree


@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("apron", [1, 2, 5])
def test_the_sizes_of_a_chunk_belong_together(cells, apron):
    shape = ChunkShape(cells, apron)
    check_shape(shape)
    assert shape.corners == cells + 1
    assert shape.samples == shape.corners + 2 * apron
    assert shape.units_per_cell * cells == POSITION_HIGH - POSITION_LOW
    assert shape.units_per_cell * cells // 2 == POSITION_LOW, "a margin of half the cells on either side"
    assert POSITION_HIGH + POSITION_LOW == 2**16


def test_a_chunk_of_32_cells_has_1024_units_a_cell():
    assert ChunkShape().units_per_cell == 1024
    assert ChunkShape() == ChunkShape(32, 1)


@pytest.mark.parametrize("shape", [ChunkShape(0), ChunkShape(31), ChunkShape(128), ChunkShape(-32), ChunkShape(32, 0)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(BadParameter):
        check_shape(shape)


@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("lod", [0, 1, 5, LOD_MAX])
def test_corners_are_exact_also_below_zero(cells, lod):
    side = cells * 2**lod
    assert ChunkKey(lod, 0, 0, 0).low_corner(cells) == (0, 0, 0)
    assert ChunkKey(lod, -1, 1, -7).low_corner(cells) == (-side, side, -7 * side)
    assert ChunkKey(lod, 0, 0, 0).step == 2**lod


@pytest.mark.parametrize("lod", [1, 2, LOD_MAX])
def test_eight_chunks_fill_one_of_the_next_level(lod):
    for x in (-3, -1, 0, 4):
        parent = ChunkKey(lod, x, x, x).low_corner(32)
        low = ChunkKey(lod - 1, 2 * x, 2 * x, 2 * x).low_corner(32)
        high = ChunkKey(lod - 1, 2 * x + 2, 2 * x + 2, 2 * x + 2).low_corner(32)
        assert low == parent
        assert high == ChunkKey(lod, x + 1, x + 1, x + 1).low_corner(32)


@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("lod", [0, 3, LOD_MAX])
def test_the_world_ends_at_its_limits_on_both_sides(cells, lod):
    side = cells << lod
    first, last = -(LATTICE_MAX // side), LATTICE_MAX // side - 1
    for axis in range(3):
        at = [0, 0, 0]
        for inside in (first, last):
            at[axis] = inside
            check_key(ChunkKey(lod, *at), cells)
        for outside in (first - 1, last + 1, 2**63, -(10**30)):
            at[axis] = outside
            with pytest.raises(BadKey, match="xyz"[axis]) as caught:
                check_key(ChunkKey(lod, *at), cells)
            assert caught.value.values == {"xyz"[axis]: outside}
    assert ChunkKey(lod, first, 0, 0).low_corner(cells)[0] == -LATTICE_MAX
    assert ChunkKey(lod, last + 1, 0, 0).low_corner(cells)[0] == LATTICE_MAX


@pytest.mark.parametrize(("lod", "lods"), [(-1, 21), (LOD_MAX + 1, 21), (12, 12), (1, 1)])
def test_other_levels_are_refused(lod, lods):
    with pytest.raises(BadKey, match=f"0 to {lods - 1}"):
        check_key(ChunkKey(lod, 0, 0, 0), 32, lods)


def test_a_mask_names_the_faces_with_a_coarser_leaf_behind():
    """By hand, and against a walk through random octrees."""
    leaves = {ChunkKey(1, -1, 0, 0), ChunkKey(1, 0, 1, 0), ChunkKey(0, 0, 0, 1), ChunkKey(2, 0, 0, -1)}
    assert coarser_mask(ChunkKey(0, 0, 1, 0), leaves) == 1 + 8
    for seed in range(3):
        tree = random_octree(np.random.default_rng(seed), 3, 0.3, (-1, -1, -1))
        masks = {key: coarser_mask(key, tree.leaves) for key in tree.leaves}
        assert masks == {key: tree.coarser(key) for key in tree.leaves}
        assert any(masks.values())
