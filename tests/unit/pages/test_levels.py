"""The measure of levels finds what it should: stray pieces, welded over chunk borders, and triangles per chunk."""

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.mesh import Mesh
from chunkserver.recipe import WorldRecipe, canonical
from pages.levels import measure, stray_pieces
from tests.worlds import cut

CELLS = 32
SIDE = 2 * CELLS + 3


def balls(*placed: tuple[float, float, float, float]) -> list[tuple[ChunkKey, Mesh]]:
    """Return two chunks a side with balls of rock: x, y, z in cells from the low corner of all, and a radius."""
    y, z, x = np.indices((SIDE,) * 3) - 1.0
    distances = [np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) - radius for a, b, c, radius in placed]
    return [pair for pair in cut(np.min(distances, axis=0).astype(np.float32), CELLS) if not pair[1].is_empty]


LARGE = (10, 10, 10, 5)


@pytest.mark.parametrize(
    ("small", "expected"),
    [
        ((20, 20, 20, 0.9), 1),
        ((20, 20, 20, 1.1), 0),
        ((CELLS, 20, 20, 0.9), 1),  # on a face that two chunks share
        ((CELLS, CELLS, CELLS, 0.9), 1),  # at a corner that eight chunks share
        ((2 * CELLS, 20, 20, 0.9), 0),  # cut off by the border: it goes on outside
    ],
)
def test_small_closed_pieces_are_stray(small, expected):
    assert stray_pieces(balls(LARGE, small)) == expected


def test_a_bubble_of_air_is_stray_too():
    y, z, x = np.indices((SIDE,) * 3) - 1.0
    bubble = 0.9 - np.sqrt((x - 20) ** 2 + (y - 20) ** 2 + (z - 20) ** 2)
    chunks = list(cut(np.maximum(y - 50.5, bubble).astype(np.float32), CELLS))
    assert stray_pieces([pair for pair in chunks if not pair[1].is_empty]) == 1


def test_a_long_thin_piece_is_not_stray():
    y, z, x = np.indices((SIDE,) * 3) - 1.0
    rod = np.sqrt((y - 20) ** 2 + (z - 20) ** 2 + np.maximum(np.abs(x - 20) - 3, 0) ** 2) - 0.9
    ball = np.sqrt((x - 10) ** 2 + (y - 40) ** 2 + (z - 40) ** 2) - 5
    chunks = cut(np.minimum(rod, ball).astype(np.float32), CELLS)
    assert stray_pieces([pair for pair in chunks if not pair[1].is_empty]) == 0


def test_the_only_piece_is_the_world_itself():
    assert stray_pieces(balls((20, 20, 20, 0.9))) == 0


def test_every_stray_piece_counts():
    assert stray_pieces(balls((20, 20, 20, 0.9), (40, 40, 40, 0.9), (50, 20, 40, 0.9))) == 3


@pytest.mark.parametrize("lod", [0, 3, 8])
def test_a_plane_has_two_triangles_a_cell_at_every_level(lod):
    plane = measure(WorldRecipe(0, canonical("plane")), (5, 0, -1000), lod, aside=2)
    assert plane == (lod, 4, 2 * CELLS**2, 2 * CELLS**2, 0)


def test_the_view_is_around_its_place_at_every_level():
    ball = WorldRecipe(0, canonical({"builtin": "sphere", "radius": 2000}))
    assert all(measure(ball, (0, 2000, 0), lod, aside=2).chunks >= 4 for lod in range(6))


def test_a_place_without_surface_has_nothing():
    assert measure(WorldRecipe(0, canonical("plane")), (0, 10_000, 0), 0, aside=2) == (0, 0, 0, 0, 0)
