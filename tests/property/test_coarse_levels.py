"""A planet seen whole at the coarsest levels: one closed ball, without a trace of what those levels cannot show."""

import math

import numpy as np
import pytest

from chunkserver.field import prove, sample
from chunkserver.grid import CELLS_DEFAULT, LOD_MAX, ChunkKey, ChunkShape
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe, builtin
from tests.octrees import Octree
from tests.surfaces import (
    CHUNK_UNITS,
    assert_closed,
    assert_no_degenerate,
    assert_watertight,
    edges_of,
    volume,
    weld,
    world_points,
)
from tests.worlds import chunk_mesh, keys

SEED = 3
EARTH = 6_400_000.0


def meshed(recipe: WorldRecipe, key: ChunkKey) -> Mesh:
    proven = prove(recipe, key, ChunkShape())
    return EMPTY[proven] if proven else chunk_mesh(recipe, key)


@pytest.mark.parametrize(
    ("name", "radius", "lod"),
    [("planet", EARTH, LOD_MAX), ("planet", EARTH, 18), ("planet", 10 * EARTH, LOD_MAX), ("sphere", 2**26, LOD_MAX)],
)
def test_a_planet_seen_whole_is_one_ball(name: str, radius: float, lod: int):
    """It shrinks by less than a cell: what is left out is relief and caves, which are a millionth of it."""
    recipe, step = WorldRecipe(SEED, builtin(name, radius=radius)), 2**lod
    reach = math.ceil(radius / (CELLS_DEFAULT * step)) + 1
    chunks = [(key, meshed(recipe, key)) for key in keys(lod, (-reach,) * 3, (reach,) * 3)]
    surface = weld(chunks)
    assert_watertight(surface)
    assert_no_degenerate(surface)
    points, ends = np.unique(surface.triangles), edges_of(surface).ends
    assert len(points) - len(ends) + len(surface.triangles) == 2, "one piece without a hole through it"
    cubic_voxels = volume(surface) * (CELLS_DEFAULT * step / CHUNK_UNITS) ** 3
    assert (cubic_voxels * 3 / (4 * math.pi)) ** (1 / 3) == pytest.approx(radius, abs=step / 4)


def test_a_planet_seen_whole_at_mixed_levels_is_closed():
    """From LOD 20 down to 18 towards one place; the planet stays inside the box."""
    recipe, tree = WorldRecipe(SEED, builtin("planet", radius=4 * EARTH)), Octree(LOD_MAX, (-1, -1, -1))
    for key in (ChunkKey(20, 0, 0, 0), ChunkKey(19, 1, 0, 0)):
        tree.split(key)
    masks = {key: tree.coarser(key) for key in tree.leaves}
    assert len(set(masks.values())) > 4
    chunks = [(key, extract(sample(recipe, key, ChunkShape(), mask))) for key, mask in masks.items()]
    assert {key.lod for key, mesh in chunks if not mesh.is_empty} == {18, 19, 20}
    surface = weld(chunks)
    assert_closed(surface)
    finest = min(key.lod for key in masks)
    radii = np.linalg.norm(world_points(surface, finest, CELLS_DEFAULT), axis=1)
    assert np.abs(radii - 4 * EARTH).max() < 2**LOD_MAX / 2
