"""The meshes of many chunks as one: where its points are, and which of its edges a picture may draw."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver_client import ChunkMesh
from pages.weld import edges, weld

Vectors = NDArray[np.float64]
Integers = NDArray[np.int64]

SMALLEST_AREA: Final = 1e-12
"""Square voxels. A triangle without area has the normal 0."""


class Surface(NamedTuple):
    """Chunks put side by side, each with vertices of its own.

    points: (V, 3) in the world, voxels. normals: (V, 3), unit, into the air. triangles: (T, 3).
    chunk: (V,) the number of each vertex's chunk, in the order of `keys`. step: (V,) voxels, of its chunk's cells.
    triangle_edges, border_edges, rim_edges: (E, 2) pairs of vertices. Borders lie in the faces of a chunk. Rims are
        edges that are still open when all chunks are welded by exact equality.
    """

    points: Vectors
    normals: Vectors
    triangles: Integers
    chunk: Integers
    step: Integers
    triangle_edges: Integers
    border_edges: Integers
    rim_edges: Integers


def joined(meshes: Sequence[ChunkMesh]) -> Surface:
    """Return the surface of chunks of one world, voxel size 1. Raises `ValueError` if there are none."""
    if not meshes:
        raise ValueError("no chunk of the picture has a surface")
    counts = [len(mesh.positions) for mesh in meshes]
    starts = np.cumsum([0, *counts])
    triangles = np.concatenate(
        [mesh.triangles.astype(np.int64) + start for mesh, start in zip(meshes, starts, strict=False)]
    )
    sides, _ = edges(triangles)
    return Surface(
        points=np.concatenate([mesh.positions_in_metres() for mesh in meshes]),
        normals=np.concatenate([mesh.unit_normals() for mesh in meshes]).astype(np.float64),
        triangles=triangles,
        chunk=np.repeat(np.arange(len(meshes)), counts),
        step=np.repeat([1 << mesh.key.lod for mesh in meshes], counts),
        triangle_edges=sides,
        border_edges=sides[_in_faces(meshes, sides)],
        rim_edges=_rims(meshes, triangles),
    )


def facets(surface: Surface) -> tuple[Integers, Vectors]:
    """Return the vertices of all triangles one after the other, (3 T,), and for each the normal of its triangle."""
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), SMALLEST_AREA)
    return surface.triangles.reshape(-1), np.repeat(normals, 3, axis=0)


def _in_faces(meshes: Sequence[ChunkMesh], sides: Integers) -> NDArray[np.bool_]:
    """Return which sides of triangles lie in one face of their chunk, (E,)."""
    place = np.concatenate([mesh.chunk_positions() for mesh in meshes])
    on_face = (place == POSITION_LOW).astype(np.int8) + 2 * (place == POSITION_HIGH).astype(np.int8)
    first, second = on_face[sides[:, 0]], on_face[sides[:, 1]]
    return np.asarray(((first == second) & (first > 0)).any(axis=1))


def _rims(meshes: Sequence[ChunkMesh], triangles: Integers) -> Integers:
    """Return the edges that are open in the welded whole, as pairs of unwelded vertices."""
    welded, number = weld(np.concatenate([mesh.lattice_positions() for mesh in meshes]))
    some = np.empty(len(welded), np.int64)
    some[number] = np.arange(len(number))
    sides, balance = edges(number[triangles])
    return np.asarray(some[sides[balance != 0]])
