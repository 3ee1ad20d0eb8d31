"""Chunks put together in exact integers, and what a surface must be: closed, manifold, without degenerate triangles.

Positions of chunks of one level are integers on a common lattice: `chunk coordinate * 32768 + position - 16384` lattice
units of that level. Vertices are welded by equality, never by distance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey
from chunkserver.mesh import Mesh

CHUNK_UNITS = POSITION_HIGH - POSITION_LOW

_Ints = NDArray[np.int64]


class Surface(NamedTuple):
    """Welded chunks.

    points: (V, 3) int64, lattice units of the level, x y z.
    triangles: (T, 3) int64.
    low, high: (3,) int64, the box of the chunks that were put together, same units.
    """

    points: _Ints
    triangles: _Ints
    low: _Ints
    high: _Ints


def weld(chunks: Iterable[tuple[ChunkKey, Mesh]]) -> Surface:
    """Put chunks of one level together by exact equality of positions."""
    points, triangles, keys, count = [np.empty((0, 3), np.int64)], [np.empty((0, 3), np.int64)], [], 0
    for key, mesh in chunks:
        corner = np.array(key[1:], np.int64)
        keys.append(corner)
        points.append(mesh.positions[:, :3].astype(np.int64) - POSITION_LOW + corner * CHUNK_UNITS)
        triangles.append(mesh.triangles.astype(np.int64) + count)
        count += len(mesh.positions)
    unique, place = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    low, high = np.min(keys, axis=0) * CHUNK_UNITS, (np.max(keys, axis=0) + 1) * CHUNK_UNITS
    return Surface(unique, place.reshape(-1)[np.concatenate(triangles)], low, high)


def edge_balance(surface: Surface) -> tuple[_Ints, _Ints, _Ints]:
    """Return each undirected edge (E, 2), how often it is walked in all, and forwards less backwards."""
    walked = np.concatenate([surface.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    direction = np.where(walked[:, 0] < walked[:, 1], 1, -1)
    edges, place = np.unique(np.sort(walked, axis=1), axis=0, return_inverse=True)
    place = place.reshape(-1)
    return edges, np.bincount(place, minlength=len(edges)), np.bincount(place, direction, len(edges)).astype(np.int64)


def on_border(surface: Surface, edges: _Ints) -> NDArray[np.bool_]:
    """Return which edges lie in a face of the box of chunks: both ends on the same face."""
    ends = surface.points[edges]
    both: NDArray[np.bool_] = (ends == surface.low).all(axis=1) | (ends == surface.high).all(axis=1)
    return np.asarray(both.any(axis=1))


def assert_closed(surface: Surface) -> None:
    """Every edge is walked equally often both ways, except on the outer border of the set."""
    edges, _, balance = edge_balance(surface)
    open_edges = edges[(balance != 0) & ~on_border(surface, edges)]
    assert len(open_edges) == 0, f"{len(open_edges)} open edges, first {surface.points[open_edges[0]].tolist()}"


def assert_manifold(surface: Surface) -> None:
    """Closed, and every edge inside the box carries exactly two triangles, one each way."""
    assert_closed(surface)
    edges, walks, _ = edge_balance(surface)
    crowded = edges[(walks > 2) | (walks < 2) & ~on_border(surface, edges)]
    assert len(crowded) == 0, f"{len(crowded)} non-manifold edges, first {surface.points[crowded[0]].tolist()}"


def assert_no_degenerate(surface: Surface) -> None:
    """No triangle has two equal corners or no area: exact, in integers."""
    twice_area = doubled_areas(surface)
    flat = np.flatnonzero((twice_area == 0).all(axis=1))
    assert len(flat) == 0, (
        f"{len(flat)} degenerate triangles, first {surface.points[surface.triangles[flat[0]]].tolist()}"
    )


def doubled_areas(surface: Surface) -> _Ints:
    """Return the cross product of two sides of each triangle, (T, 3), exact for triangles within a cell."""
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def volume(surface: Surface) -> float:
    """Return the enclosed volume in cubic lattice units (float64), positive when triangles face outwards."""
    a, b, c = (surface.points[surface.triangles[:, i]].astype(np.float64) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
