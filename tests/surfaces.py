"""Chunks put together in exact integers, and what a surface must be: closed, manifold, without degenerate triangles.

Positions of chunks are integers on a common lattice: `chunk coordinate * 32768 + position - 16384` lattice units of
their level, each of which is 2^n units of a level n finer. Vertices are welded by equality, never by distance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey
from chunkserver.mesh import Mesh

CHUNK_UNITS = POSITION_HIGH - POSITION_LOW
CHUNK_BITS = 15
assert CHUNK_UNITS == 1 << CHUNK_BITS
AXIS_BITS = 21
"""Bits that one coordinate of a welded point may take: three of them sort as one int64. 64 chunks a side."""
FLOAT32_EXACT = 1 << 24

_Ints = NDArray[np.int64]


class Surface(NamedTuple):
    """Welded chunks.

    points: (V, 3) int64, lattice units of the finest level from the low corner of the box, x y z.
    triangles: (T, 3) int64.
    low: (3,) int64, the chunk coordinates of the box's low corner, at the finest level.
    size: (3,) int64, lattice units: the box of the chunks that were put together.
    """

    points: _Ints
    triangles: _Ints
    low: _Ints
    size: _Ints


class Edges(NamedTuple):
    """Undirected edges.

    ends: (E, 2) int64 point numbers. walks: (E,) how often triangles walk it. balance: (E,) forwards less backwards.
    """

    ends: _Ints
    walks: _Ints
    balance: _Ints


def weld(chunks: Iterable[tuple[ChunkKey, Mesh]]) -> Surface:
    """Put chunks together by exact equality of positions; chunks of several levels on the lattice of the finest."""
    pairs = list(chunks)
    finest = min(key.lod for key, _ in pairs)
    keys = np.array([[place << key.lod - finest for place in key[1:]] for key, _ in pairs], np.int64)
    sides = np.array([1 << key.lod - finest for key, _ in pairs], np.int64)
    low = keys.min(axis=0)
    size = ((keys + sides[:, None]).max(axis=0) - low) * CHUNK_UNITS
    assert size.max() < 1 << AXIS_BITS, "the box has too many chunks a side"
    points, triangles, count = [], [], 0
    for corner, side, (_, mesh) in zip(keys - low, sides, pairs, strict=True):
        points.append((mesh.positions[:, :3].astype(np.int64) - POSITION_LOW) * side + corner * CHUNK_UNITS)
        triangles.append(mesh.triangles.astype(np.int64) + count)
        count += len(mesh.positions)
    every = np.concatenate(points)
    assert every.min(initial=0) >= 0, "a vertex outside its box of chunks"
    packed, place = np.unique(every @ (1 << AXIS_BITS * np.arange(3)), return_inverse=True)
    unique = packed[:, None] >> AXIS_BITS * np.arange(3) & (1 << AXIS_BITS) - 1
    return Surface(unique, place.reshape(-1)[np.concatenate(triangles)], low, size)


def world_points(surface: Surface, lod: int, cells: int) -> NDArray[np.float64]:
    """Return the points in voxels, (V, 3) float64: exact near the origin."""
    world: NDArray[np.float64] = np.ldexp((surface.low * CHUNK_UNITS + surface.points) * float(cells), lod - CHUNK_BITS)
    return world


def edges_of(surface: Surface) -> Edges:
    """Return every undirected edge once, with how its triangles walk it."""
    count = max(len(surface.points), 1)
    walks = []
    for i in range(3):
        start, end = surface.triangles[:, i], surface.triangles[:, (i + 1) % 3]
        walks.append(2 * (np.minimum(start, end) * count + np.maximum(start, end)) + (start < end))
    walked = np.sort(np.concatenate(walks))  # sorts many times faster than what `np.unique` needs for counts
    edge = walked >> 1
    first = np.flatnonzero(np.diff(edge, prepend=-1))
    ends = np.stack(np.divmod(edge[first], count), axis=1)
    forwards = np.add.reduceat(walked & 1, first) if len(first) else first
    times = np.diff(first, append=len(edge))
    return Edges(ends, times, 2 * forwards - times)


def on_border(surface: Surface, ends: _Ints) -> NDArray[np.bool_]:
    """Return which edges lie in a face of the box of chunks: both ends on the same face."""
    faces = np.packbits(np.concatenate([surface.points == 0, surface.points == surface.size], axis=1), axis=1)[:, 0]
    return np.asarray(faces[ends[:, 0]] & faces[ends[:, 1]] != 0)


def _refuse(surface: Surface, edges: _Ints, what: str) -> None:
    assert len(edges) == 0, f"{len(edges)} {what} edges, first {surface.points[edges[0]].tolist()}"


def assert_closed(surface: Surface) -> None:
    """Every edge is walked equally often both ways, except on the outer border of the set."""
    ends, _, balance = edges_of(surface)
    _refuse(surface, ends[(balance != 0) & ~on_border(surface, ends)], "open")


def assert_manifold(surface: Surface) -> None:
    """Closed; an edge carries two triangles, one each way, or one in the box's border; a vertex carries one fan."""
    ends, walks, balance = edges_of(surface)
    border = on_border(surface, ends)
    _refuse(surface, ends[(balance != 0) & ~border], "open")
    _refuse(surface, ends[walks != np.where(border, 1, 2)], "non-manifold")
    fans = _fans(surface)
    assert (fans == 1).all(), f"vertex {surface.points[fans != 1][0].tolist()} carries {fans[fans != 1][0]} fans"


def assert_watertight(surface: Surface) -> None:
    """Manifold, and no edge is open: not even on the border of the set."""
    assert_manifold(surface)
    ends, _, balance = edges_of(surface)
    _refuse(surface, ends[balance != 0], "open")


def _fans(surface: Surface) -> _Ints:
    """Return how many fans of triangles each vertex carries: triangles that share an edge there are of one fan."""
    count, corners = len(surface.points), surface.triangles.reshape(-1)
    number = np.arange(len(corners)).reshape(-1, 3)
    sides = [(number[:, i], number[:, (i + 1) % 3]) for i in range(3)]
    from_, to = (np.concatenate([side[i] for side in sides]) for i in range(2))
    low = np.where(corners[from_] < corners[to], from_, to)
    high = from_ + to - low
    order = np.argsort(corners[low] * count + corners[high], kind="stable")
    low, high = low[order], high[order]
    same = (corners[low[1:]] == corners[low[:-1]]) & (corners[high[1:]] == corners[high[:-1]])
    links = np.concatenate([np.stack([end[1:][same], end[:-1][same]]) for end in (low, high)], axis=1)
    graph = coo_array((np.ones(links.shape[1], np.int8), (links[0], links[1])), shape=(len(corners),) * 2)
    fan = connected_components(graph, directed=False)[1]
    first = np.unique(fan, return_index=True)[1]
    return np.bincount(corners[first], minlength=count)


def assert_no_degenerate(surface: Surface) -> None:
    """No triangle has two equal corners or no area: exact, in integers."""
    flat = np.flatnonzero((doubled_areas(surface) == 0).all(axis=1))
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


def as_manifold(surface: Surface) -> manifold3d.Manifold:
    """Return the surface as manifold3d sees it: its `status()` is `NoError` only for an oriented 2-manifold."""
    assert surface.size.max() < FLOAT32_EXACT
    mesh = manifold3d.Mesh(surface.points.astype(np.float32), surface.triangles.astype(np.uint32))
    return manifold3d.Manifold(mesh)
