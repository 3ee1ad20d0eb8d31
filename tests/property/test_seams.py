"""No crack at any level of detail: random octrees of chunks, welded by exact equality."""

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from tests.octrees import FIELDS, Octree, chunks_of, random_octree
from tests.scale import count
from tests.surfaces import Surface, assert_closed, edges_of, on_border, weld

CELLS = 16


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("levels", [2, 3])
def test_octrees_are_closed(name, levels):
    for seed in range(count(100)):
        tree = random_octree(np.random.default_rng(seed), levels, 0.2)
        assert_closed(weld(chunks_of(tree, FIELDS[name](seed), CELLS)))


def open_edges(surface: Surface) -> int:
    ends, _, balance = edges_of(surface)
    return int(((balance != 0) & ~on_border(surface, ends)).sum())


@pytest.mark.parametrize("name", FIELDS)
def test_without_a_mask_they_are_open(name):
    tree = Octree(1)
    tree.split(ChunkKey(1, 0, 0, 0))
    assert open_edges(weld(chunks_of(tree, FIELDS[name](3), CELLS, masked=False))) > 10
