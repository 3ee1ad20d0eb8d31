"""Chunks that touch share what lies between them, to the bit: samples, positions and normals, near and far away."""

from itertools import combinations, product

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import LATTICE_MAX, LOD_MAX, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.samples import Samples
from tests.scale import TORTURE
from tests.surfaces import CHUNK_UNITS
from tests.worlds import GRIDS, Corner, cut

RECIPES = {name: builtin(name) for name in ("terrain", "planet", "caves")}
RECIPES["static"] = canonical({"op": "simplex3", "frequency": 0.97})
"""Noise as fine as a recipe may ask for: neighbouring samples have little to do with each other."""

RECIPES["small planet"] = builtin("planet", radius=40)
RECIPES["swell"] = canonical({"op": "simplex3", "frequency": 2.0 ** -(LOD_MAX + 4)})
"""Noise that the coarsest level keeps: 16 of its steps a lattice cell."""

LIMIT = LATTICE_MAX // 32
BOXES = {
    "around zero": ("terrain", 0, (-1, -1, -1)),
    "negative": ("terrain", 0, (-7, -1, -4)),
    "around zero, coarse": ("terrain", 3, (-1, -1, -1)),
    "planet": ("planet", 1, (2, -1, -1)),
    "caves": ("caves", 0, (-1, 4, -1)),
    "far along x": ("terrain", 0, (LIMIT - 2, -1, 0)),
    "far along -z": ("terrain", 0, (0, -1, -LIMIT)),
    "last corner": ("caves", 0, (LIMIT - 2,) * 3),
    "first corner": ("caves", 0, (-LIMIT,) * 3),
    "last corner, coarse": ("caves", 1, (LIMIT // 2 - 2,) * 3),
    "last corner, coarsest": ("swell", LOD_MAX, ((LIMIT >> LOD_MAX) - 2,) * 3),
    "small planet": ("small planet", 0, (-1, -1, -1)),
    "static around zero": ("static", 0, (-1, -1, -1)),
    "static far": ("static", 0, (-LIMIT, LIMIT - 2, LIMIT - 2)),
}
"""Boxes of two chunks a side: recipe, LOD, key of the low corner."""


def shared(mesh: Mesh, here: Corner, there: Corner) -> dict[Corner, bytes]:
    """Return the vertices of chunk `here` that lie in chunk `there`, borders included: place -> bytes of the normal."""
    places = mesh.positions[:, :3].astype(np.int64) - POSITION_LOW + np.array(here) * CHUNK_UNITS
    low = np.array(there) * CHUNK_UNITS
    inside = ((low <= places) & (places <= low + CHUNK_UNITS)).all(axis=1)
    chosen = zip(places[inside].tolist(), mesh.normals[inside], strict=True)
    return {(x, y, z): normal.tobytes() for (x, y, z), normal in chosen}


def assert_seamless(meshes: dict[Corner, Mesh]) -> None:
    """Every two chunks of a box have the same vertices where they touch: on faces, and on edges."""
    touching: dict[int, int] = {}
    for (here, mesh), (there, other) in combinations(meshes.items(), 2):
        mine = shared(mesh, here, there)
        assert mine == shared(other, there, here)
        ways = sum(a != b for a, b in zip(here, there, strict=True))
        touching[ways] = touching.get(ways, 0) + len(mine)
    assert touching[1] > 0, "a box without a surface on any inner face shows nothing"


def same_samples(mine: Samples, theirs: Samples, axis: int) -> bool:
    """Whether a chunk and the next one along an axis of their arrays agree where both have samples, to the bit."""
    width = 2 * mine.shape.apron + 1
    high, low = np.moveaxis(mine.density, axis, 0)[-width:], np.moveaxis(theirs.density, axis, 0)[:width]
    return high.tobytes() == low.tobytes()


@pytest.mark.parametrize("normals", ["int8", "float32"])
@pytest.mark.parametrize("where", BOXES)
def test_chunks_of_a_world(where, normals):
    recipe, lod, (x, y, z) = BOXES[where]
    world = WorldRecipe(3, RECIPES[recipe])
    samples = {
        (i, j, k): sample(world, ChunkKey(lod, x + i, y + j, z + k), ChunkShape())
        for i, j, k in product((0, 1), repeat=3)
    }
    for i, j in product((0, 1), repeat=2):
        assert same_samples(samples[0, i, j], samples[1, i, j], axis=2)
        assert same_samples(samples[i, 0, j], samples[i, 1, j], axis=0)
        assert same_samples(samples[i, j, 0], samples[i, j, 1], axis=1)
    assert_seamless({place: extract(mine, normals=normals) for place, mine in samples.items()})


@pytest.mark.parametrize("normals", ["int8", "float32"])
@pytest.mark.parametrize("cells", [16, 32, 64] if TORTURE else [16])
@pytest.mark.parametrize("kind", GRIDS)
def test_chunks_of_a_made_up_grid(kind, cells, normals, rng):
    density = GRIDS[kind](rng, ChunkShape(cells).samples + cells)
    assert_seamless({key[1:]: mesh for key, mesh in cut(density, cells, normals)})
