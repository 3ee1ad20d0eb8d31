"""What a level of detail costs and whether it speckles: triangles per chunk and stray pieces, in reference views.

A reference view is a cube of chunks around a place of the recipe, of the same number of chunks at every level: what
somebody there sees of that level. So the view grows with the level, as the rings of levels around an eye do.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from chunkserver.field import sample
from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe
from pages.weld import edges, weld

Place = tuple[int, int, int]
Chunks = Sequence[tuple[ChunkKey, Mesh]]

LODS: Final = range(9)
CHUNKS_ASIDE: Final = 8
"""Chunks a side of a reference view. Even: the place lies in one of the eight in the middle."""
GROWTH_MAX: Final = 3.0
"""How many times the triangles per chunk of LOD 0 any other level may have."""
STRAY_CELLS: Final = 2
"""A closed piece of surface is stray if its extent along every axis is under so many cells."""

PLACES: Final[dict[str, Place]] = {
    "planet": (0, 200, 0),
    "moon": (0, 400, 0),
    "ring": (0, 0, -640),
    "continents": (0, 10_020, 0),
}
"""Where the reference view of a built-in is, in voxels: where its surface is. The origin for the others."""

SHAPE: Final = ChunkShape()
CHUNK_UNITS: Final = POSITION_HIGH - POSITION_LOW

assert CHUNKS_ASIDE % 2 == 0


class Level(NamedTuple):
    """What one level of a reference view has: chunks with a surface, their triangles, and stray pieces."""

    lod: int
    chunks: int
    triangles_mean: float
    triangles_max: int
    stray: int


def place_of(name: str) -> Place:
    """Return the place of a built-in's reference view."""
    return PLACES.get(name, (0, 0, 0))


def measure(recipe: WorldRecipe, place: Place, lod: int, aside: int = CHUNKS_ASIDE) -> Level:
    """Return the figures of one level of the view of `aside` chunks a side around `place`, in voxels.

    A level without any surface has 0 everywhere.
    """
    chunks = [(key, mesh) for key, mesh in view(recipe, place, lod, aside) if not mesh.is_empty]
    counts = [len(mesh.triangles) for _, mesh in chunks] or [0]
    return Level(lod, len(chunks), sum(counts) / len(counts), max(counts), stray_pieces(chunks) if chunks else 0)


def view(recipe: WorldRecipe, place: Place, lod: int, aside: int = CHUNKS_ASIDE) -> Iterable[tuple[ChunkKey, Mesh]]:
    """Yield the chunks of one level of a reference view, empty ones too."""
    side = SHAPE.cells << lod
    low = [round(coordinate / side) - aside // 2 for coordinate in place]
    for offset in product(range(aside), repeat=3):
        key = ChunkKey(lod, *(corner + step for corner, step in zip(low, offset, strict=True)))
        yield key, extract(sample(recipe, key, SHAPE))


def stray_pieces(chunks: Chunks) -> int:
    """Return how many closed pieces of the surface have an extent under STRAY_CELLS cells.

    chunks: of one level, welded by equality. A piece with an open edge is not closed: it goes on in a chunk that is not
    here. A piece that is all there is is no stray: it is the world, seen from far away.
    """
    points, triangles = _weld(chunks)
    piece = _pieces(triangles, len(points))
    low, high = _extents(points, piece)
    small = (high - low < STRAY_CELLS * SHAPE.units_per_cell).all(axis=1)
    is_open = np.zeros(len(low), np.bool_)
    sides, balance = edges(triangles)
    is_open[piece[sides[balance != 0]]] = True
    return int(np.count_nonzero(small & ~is_open)) if len(low) > 1 else 0


def _weld(chunks: Chunks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (V, 3) points in lattice units, and (T, 3) triangles."""
    corners = np.array([key[1:] for key, _ in chunks], np.int64) * CHUNK_UNITS
    parts = [mesh.positions[:, :3] + corner for corner, (_, mesh) in zip(corners, chunks, strict=True)]
    starts = np.cumsum([0, *map(len, parts)])
    triangles = [mesh.triangles + start for start, (_, mesh) in zip(starts, chunks, strict=False)]
    points, number = weld(np.concatenate(parts))
    return points, number[np.concatenate(triangles)]


def _pieces(triangles: NDArray[np.int64], vertices: int) -> NDArray[np.int64]:
    """Return the number of each vertex's piece: vertices that share a triangle are of one piece."""
    ends = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
    graph = coo_array((np.ones(len(ends[0]), np.bool_), ends), shape=(vertices, vertices))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _extents(points: NDArray[np.int64], piece: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the low and the high corner of each piece."""
    order = np.argsort(piece, kind="stable")
    starts = np.flatnonzero(np.diff(piece[order], prepend=-1))
    return np.minimum.reduceat(points[order], starts), np.maximum.reduceat(points[order], starts)
