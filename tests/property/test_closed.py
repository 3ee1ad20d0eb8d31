"""Surfaces are closed, manifold and without degenerate triangles, whatever the samples: made up, or of a world."""

import json
from itertools import product

import numpy as np
import pytest

from chunkserver.grid import CELLS_BUILT, LATTICE_MAX, LOD_MAX, ChunkShape
from chunkserver.recipe import WorldRecipe, builtin, canonical
from tests.scale import TORTURE, count
from tests.surfaces import Surface, as_manifold, assert_manifold, assert_no_degenerate, assert_watertight, volume, weld
from tests.worlds import GRIDS, SMALLEST, box_of_chunks, cut, in_air, one_chunk


def assert_solid(surface: Surface) -> None:
    """The surface is that of solid bodies: watertight, and manifold3d agrees on it and on what it encloses."""
    assert_watertight(surface)
    assert_no_degenerate(surface)
    manifold = as_manifold(surface)
    assert manifold.status().name == "NoError"
    assert manifold.volume() == pytest.approx(volume(surface), rel=1e-6)
    assert volume(surface) > 0


@pytest.mark.parametrize("kind", GRIDS)
def test_random_grids(kind, rng):
    """1,000 grids of each kind, each twice: as it is, open on the border of its chunk, and with air around it."""
    for _ in range(count(1_000)):
        density = GRIDS[kind](rng, SMALLEST.samples)
        surface = weld(one_chunk(density))
        assert_manifold(surface)
        assert_no_degenerate(surface)
        assert_solid(weld(one_chunk(in_air(density))))


@pytest.mark.parametrize("cells", CELLS_BUILT if TORTURE else [16, 32])
@pytest.mark.parametrize("kind", GRIDS)
def test_random_grids_of_several_chunks(cells, kind, rng):
    """Two chunks a side: what closes inside a chunk also closes across its faces, edges and corner."""
    side = ChunkShape(cells).samples + cells
    surface = weld(cut(GRIDS[kind](rng, side), cells))
    assert (surface.size == 2 << 15).all()
    assert_manifold(surface)
    assert_no_degenerate(surface)


def test_white_noise_in_the_largest_chunk(rng):
    surface = weld(one_chunk(GRIDS["white noise"](rng, ChunkShape(64).samples)))
    assert len(surface.triangles) > 500_000
    assert_manifold(surface)
    assert_no_degenerate(surface)


ZEROS: dict[str, tuple[int | slice, int | slice, int | slice]] = {
    "a corner": (5, 5, 5),
    "an edge": (slice(5, 7), 5, 5),
    "a face": (slice(5, 7), slice(5, 7), 5),
    "a cell": (slice(5, 7),) * 3,
    "a row": (slice(None), 5, 5),
    "a plane": (slice(None), slice(None), 5),
    "every second plane": (slice(None), slice(None), slice(None, None, 2)),
    "the border of the chunk": (slice(None), 1, slice(None)),
    "two crossing planes": (slice(None), slice(5, 6), slice(5, 6)),
}


@pytest.mark.parametrize("where", ZEROS)
@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("zero", [0.0, -0.0])
@pytest.mark.parametrize("kind", ["rock", "white noise"])
def test_samples_exactly_at_the_isovalue(where, turn, zero, kind, rng):
    make = GRIDS.get(kind, lambda _, side: np.full((side,) * 3, -1, np.float32))
    density = make(rng, SMALLEST.samples)
    axes = np.roll([0, 1, 2], turn)
    density.transpose(axes)[ZEROS[where]] = zero
    surface = weld(one_chunk(density))
    assert_manifold(surface)
    assert_no_degenerate(surface)
    assert_solid(weld(one_chunk(in_air(density))))


def capped(recipe: str, low: float, high: float) -> WorldRecipe:
    """Return a built-in world cut off outside of a box: rock in the box alone."""
    tree = json.loads(builtin(recipe))
    for axis in ({"op": "x"}, {"op": "y"}, {"op": "z"}):
        for a, b in ((axis, high), (low, axis)):
            tree = {"op": "max", "a": tree, "b": {"op": "subtract", "a": a, "b": b}}
    return WorldRecipe(11, canonical(tree))


def world_surface(recipe: WorldRecipe, lod: int, chunks: int, cells: int = 32) -> Surface:
    """Return a box of `chunks` chunks to each side of the origin."""
    return weld(box_of_chunks(recipe, lod, (-chunks,) * 3, (chunks,) * 3, cells))


@pytest.mark.parametrize("recipe", ["terrain", "hills", "caves"])
@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("end", [15, 15.3])
def test_a_box_cut_out_of_a_world_is_solid(recipe, cells, end):
    """The cut lies on samples, which then are exactly at the isovalue, or between them."""
    assert_solid(world_surface(capped(recipe, -end, end), 0, 1, cells))


@pytest.mark.parametrize("recipe", ["terrain", "hills", "caves"])
@pytest.mark.parametrize("lod", [0, 1, 2, 3, 4, 12])
def test_worlds_are_closed_at_every_level(recipe, lod):
    surface = world_surface(WorldRecipe(3, builtin(recipe)), lod, 2 if TORTURE else 1)
    assert_manifold(surface)
    assert_no_degenerate(surface)


@pytest.mark.parametrize(("lod", "chunks"), [(0, 8), (1, 4), (2, 2), (3, 1), (4, 1)] if TORTURE else [(2, 2), (4, 1)])
def test_the_planet_is_solid(lod, chunks):
    assert_solid(world_surface(WorldRecipe(7, builtin("planet")), lod, chunks))


def test_a_small_planet_is_solid_at_the_finest_level():
    assert_solid(world_surface(WorldRecipe(7, builtin("planet", radius=40, relief=12)), 0, 2))


@pytest.mark.parametrize("corner", list(product((0, 1), repeat=3)))
def test_far_from_the_origin(corner):
    """At the last chunks of the world's eight corners."""
    recipe, limit = WorldRecipe(5, builtin("caves")), (1 << 40) // 32
    x, y, z = (limit - 2 if last else -limit for last in corner)
    surface = weld(box_of_chunks(recipe, 0, (x, y, z), (x + 2, y + 2, z + 2)))
    assert len(surface.triangles) > 1000
    assert_manifold(surface)
    assert_no_degenerate(surface)


@pytest.mark.parametrize("last", [False, True])
def test_far_from_the_origin_at_the_coarsest_level(last):
    """Noise of 16 steps a lattice cell, which the level keeps."""
    recipe = WorldRecipe(5, canonical({"op": "simplex3", "frequency": 2.0 ** -(LOD_MAX + 4)}))
    limit = LATTICE_MAX // (32 << LOD_MAX)
    low = limit - 2 if last else -limit
    surface = weld(box_of_chunks(recipe, LOD_MAX, (low,) * 3, (low + 2,) * 3))
    assert len(surface.triangles) > 1000
    assert_manifold(surface)
    assert_no_degenerate(surface)
