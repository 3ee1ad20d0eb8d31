"""Chunks of one LOD put together: a vertex that several chunks have is one vertex.

Vertices are the same if their integer positions are equal, never because they are near. So a closed surface stays
closed, whatever a file's numbers can hold.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey
from chunkserver.mesh import Mesh

CHUNKS_MAX: Final = 1 << 15
"""Of a box: 32 a side."""
CHUNK_UNITS: Final = POSITION_HIGH - POSITION_LOW

assert (CHUNKS_MAX + 1) * 2 * 2 * CHUNK_UNITS**3 < 1 << 63, (
    "a position in the longest box, margins included, is an int64"
)


class Welded(NamedTuple):
    """The mesh of a box of chunks.

    points: (V, 3) int64, lattice units of the LOD from the low corner of the box, x y z.
    normals: (V, 3) float32, unit length, into the air.
    triangles: (T, 3) int64, counter-clockwise seen from the air.
    """

    points: NDArray[np.int64]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int64]


def weld(chunks: Sequence[tuple[ChunkKey, Mesh]], low: ChunkKey, high: ChunkKey) -> Welded:
    """Return the meshes of a box of chunks as one: its vertices in the order of their positions.

    chunks: those that have a surface, with float32 normals; at least one. Neighbours agree on the normals of shared
        vertices to the bit.
    low, high: the chunks in the corners of the box, which has at most CHUNKS_MAX chunks.
    """
    corner = np.array(low[1:], np.int64)
    points, triangles, count = [], [], 0
    for key, mesh in chunks:
        place = (np.array(key[1:], np.int64) - corner) * CHUNK_UNITS
        points.append(mesh.positions[:, :3] + place)  # from the low end of the margin, so never negative
        triangles.append(mesh.triangles.astype(np.int64) + count)
        count += len(mesh.positions)
    _, width, depth = (np.array(high[1:], np.int64) - corner + 2) * CHUNK_UNITS
    x, y, z = np.concatenate(points).T
    _, first, place_of = np.unique((x * width + y) * depth + z, return_index=True, return_inverse=True)
    normals = np.concatenate([mesh.normals for _, mesh in chunks])
    return Welded(
        np.stack([x, y, z], axis=1)[first] - POSITION_LOW,
        normals[first].astype(np.float32, copy=False),
        place_of.reshape(-1)[np.concatenate(triangles)],
    )
