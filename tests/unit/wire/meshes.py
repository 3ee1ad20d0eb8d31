"""Small meshes of a given size, and their placements: what the writers are tried on."""

import numpy as np
from hypothesis import strategies as st

from chunkserver.grid import CELLS_BUILT, LATTICE_MAX, LOD_MAX, ChunkKey
from chunkserver.mesh import Mesh, NormalKind, as_indices
from chunkserver.wire import Placement

PLACEMENT = Placement(ChunkKey(2, -3, 0, 5), 32, 0.5, 7, 0)


def strip(vertices: int, normals: NormalKind = "int8") -> Mesh:
    """Return a strip through `vertices` (at least 3) scattered vertices: no triangle has two equal corners."""
    rng = np.random.default_rng(vertices)
    positions = rng.integers(0, 65536, (vertices, 4)).astype(np.uint16)
    positions[:, 3] = 65535
    directions = rng.normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    as_bytes = np.zeros((vertices, 4), np.int8)
    as_bytes[:, :3] = np.rint(127 * directions)
    first = np.arange(vertices - 2, dtype=np.uint32)
    return Mesh(
        "surface",
        positions,
        as_bytes if normals == "int8" else directions.astype(np.float32),
        as_indices(np.stack([first, first + 1, first + 2], axis=1).astype(np.uint32), vertices),
    )


@st.composite
def placements(draw: st.DrawFn, voxel_size: st.SearchStrategy[float]) -> Placement:
    """Any chunk that the lattice holds."""
    cells = draw(st.sampled_from(CELLS_BUILT))
    lod = draw(st.integers(0, LOD_MAX))
    limit = LATTICE_MAX // (cells << lod)
    axis = st.integers(-limit, limit - 1)
    key = ChunkKey(lod, draw(axis), draw(axis), draw(axis))
    coarser = draw(st.integers(0, 63 if lod < LOD_MAX else 0))
    error = draw(st.just(-1.0) | st.floats(0, 2.0**60))
    return Placement(key, cells, draw(voxel_size), draw(st.integers(0, 2**63 - 1)), coarser, error)


powers_of_two = st.integers(-20, 20).map(lambda exponent: 2.0**exponent)
