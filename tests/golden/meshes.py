"""The chunks that are written down, and how."""

import hashlib
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import sample
from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh, NormalKind
from chunkserver.mesher import extract
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from tests.worlds import chunk_mesh

FOLDER = Path(__file__).parent
SEED = 7
DIGEST_BYTES = 6

KEYS = [
    ChunkKey(0, 0, 0, 0),
    ChunkKey(0, 1, -1, 0),
    ChunkKey(0, -2, 0, 1),
    ChunkKey(1, 3, -1, 0),
    ChunkKey(2, -1, 0, -1),
    ChunkKey(4, 0, -1, 0),
    ChunkKey(0, 2**34 - 1, -1, -(2**34)),
]
"""Within the world for each size of chunk."""
FURTHER_KEYS = {"continents": [ChunkKey(0, 100, -272, -122), ChunkKey(2, 37, 37, 57), ChunkKey(9, 0, 0, -1)]}
"""Where there is ground of a world that has none around the origin."""
MASKS = (1, 26, 63)
"""Of faces with coarser neighbours."""

COLUMNS = ("recipe", "cells", "lod", "x", "y", "z", "content", "vertices", "triangles")
DIGESTS = ("positions", "int8", "float32", "indices")
WIDTHS = (8, 5, 4, 11, 3, 12, 8, 9, 9) + (2 * DIGEST_BYTES,) * len(DIGESTS)


def chunk_lines() -> Iterator[str]:
    """Yield the lines of `chunks.txt`: a heading, then a chunk each."""
    yield _columns(*COLUMNS, *DIGESTS)
    keys = [(recipe, key) for recipe in BUILTINS for key in KEYS + FURTHER_KEYS.get(recipe, [])]
    for (recipe, key), cells in product(keys, CELLS_BUILT):
        world = WorldRecipe(SEED, builtin(recipe))
        mesh, floats = chunk_mesh(world, key, cells), chunk_mesh(world, key, cells, "float32")
        yield _columns(recipe, cells, *key, *_described(mesh, floats))


def seam_lines() -> Iterator[str]:
    """Yield the lines of `seams.txt`: a heading, then a chunk each, fitted to coarser neighbours or with skirts."""
    yield _columns("seam", *COLUMNS, *DIGESTS, widths=(7, *WIDTHS))
    shape = ChunkShape(CELLS_DEFAULT)
    for recipe, key, mask in product(("terrain", "planet"), KEYS[:5], (0, *MASKS)):
        samples = sample(WorldRecipe(SEED, builtin(recipe)), key, shape, mask)
        mesh, floats = (extract(samples, normals=kind, skirts=not mask) for kind in get_args(NormalKind))
        line = _described(mesh, floats)
        yield _columns(mask or "skirts", recipe, CELLS_DEFAULT, *key, *line, widths=(7, *WIDTHS))


def octant_lines() -> Iterator[str]:
    """Yield the lines of `octant.txt`: one eighth of a sphere of radius 2.25 voxels, in chunks of 16 cells."""
    mesh = chunk_mesh(WorldRecipe(SEED, builtin("sphere", radius=2.25)), ChunkKey(0, 0, 0, 0), 16)
    for number, (position, normal) in enumerate(zip(mesh.positions, mesh.normals, strict=True)):
        yield _columns("vertex", number, *position, *normal, widths=(6, 4, 7, 6, 6, 6, 6, 4, 4, 4))
    for triangle in mesh.triangles:
        yield _columns("triangle", *triangle, widths=(8, 4, 3, 3))


FILES = {"chunks.txt": chunk_lines, "seams.txt": seam_lines, "octant.txt": octant_lines}


def _described(mesh: Mesh, floats: Mesh) -> tuple[object, ...]:
    """Return content, counts and digests of a mesh. floats: the same one with float32 normals."""
    arrays = (mesh.positions, mesh.normals, floats.normals, mesh.triangles.astype(np.uint32))
    digests = () if mesh.is_empty else map(_digest, arrays)
    return mesh.content, len(mesh.positions), len(mesh.triangles), *digests


def _digest(array: NDArray[np.generic]) -> str:
    little = array.astype(array.dtype.newbyteorder("<"))
    return hashlib.blake2b(little.tobytes(), digest_size=DIGEST_BYTES).hexdigest()


def _columns(*values: object, widths: tuple[int, ...] = WIDTHS) -> str:
    return " ".join(f"{value!s:>{width}}" for value, width in zip(values, widths, strict=False)).rstrip()
