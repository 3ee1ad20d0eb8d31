"""Skirts: where they are, how they are turned, what they cost, and that the surface is left alone."""

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from chunkserver.field import sample
from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.mesher.skirts import HEIGHT_CELLS
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples
from tests.worlds import GRIDS

COST_MAX = 0.25
IN_AIR_MAX = 0.001
"""Of a skirt's area, at LOD 0 where caves pass close below the ground. Other seeds have up to 0.0023."""
VIEWS = {
    "hills": [ChunkKey(0, x, y, z) for x in range(3) for y in (-1, 0) for z in range(3)],
    "planet": [ChunkKey(1, x, 3, z) for x in range(-2, 2) for z in range(-2, 2)],
    "terrain": [ChunkKey(0, x, -1, z) for x in range(3) for z in range(3)],
}


def both(samples, normals="int8"):
    return extract(samples, normals=normals), extract(samples, normals=normals, skirts=True)


def grids(cells):
    rng = np.random.default_rng(3)
    for grid in GRIDS.values():
        yield Samples(ChunkShape(cells), grid(rng, cells + 3))
    yield sample(WorldRecipe(7, builtin("terrain")), ChunkKey(1, 0, -1, 0), ChunkShape(cells))


def in_faces(positions, triangles):
    """Return which triangles lie in a face of the chunk: (T,)."""
    corners = positions[triangles, :3]
    flat = (corners == corners[:, :1]).all(axis=1)
    return (flat & ((corners[:, 0] == POSITION_LOW) | (corners[:, 0] == POSITION_HIGH))).any(axis=1)


@pytest.mark.parametrize("cells", [16, 32, 64])
@pytest.mark.parametrize("normals", ["int8", "float32"])
def test_the_surface_is_left_alone_and_skirts_lie_in_the_faces_and_the_margin(cells, normals):
    for samples in grids(cells):
        plain, skirted = both(samples, normals)
        vertices, triangles = len(plain.positions), len(plain.triangles)
        assert len(skirted.triangles) > triangles
        assert np.array_equal(skirted.positions[:vertices], plain.positions)
        assert np.array_equal(skirted.normals[:vertices], plain.normals)
        assert np.array_equal(skirted.triangles[:triangles], plain.triangles)
        assert in_faces(skirted.positions, skirted.triangles[triangles:]).all()
        reach = HEIGHT_CELLS * samples.shape.units_per_cell
        assert reach < POSITION_LOW
        assert skirted.positions[:, :3].min() >= POSITION_LOW - reach
        assert skirted.positions[:, :3].max() <= POSITION_HIGH + reach
        assert skirted.triangles.max() < len(skirted.positions)
        assert (skirted.positions[:, 3] == plain.positions[0, 3]).all()


@pytest.mark.parametrize("cells", [16, 32])
def test_a_skirt_goes_on_where_the_surface_ends(cells):
    """Each border edge of the surface is walked once by it and once, the other way, by a skirt that reaches down."""
    for samples in grids(cells):
        plain, skirted = both(samples)
        count = len(skirted.positions)

        def walked(triangles, count=count):
            return np.concatenate([triangles[:, i].astype(np.int64) * count + triangles[:, i - 2] for i in range(3)])

        surface, skirt = (
            walked(skirted.triangles[: len(plain.triangles)]),
            walked(skirted.triangles[len(plain.triangles) :]),
        )
        a, b = np.divmod(surface, count)
        border = surface[~np.isin(b * count + a, surface)]
        a, b = np.divmod(border, count)
        back = np.isin(b * count + a, skirt)
        assert not np.isin(border, skirt).any()
        assert back.any()
        upper = skirt[np.logical_and(*(end < len(plain.positions) for end in np.divmod(skirt, count)))]
        assert np.isin(upper, b * count + a).all()


@pytest.mark.parametrize("normals", ["int8", "float32"])
def test_a_lower_end_has_the_normal_of_the_vertex_that_it_hangs_from(normals):
    plain, skirted = both(sample(WorldRecipe(7, builtin("terrain")), ChunkKey(0, 0, -1, 0), ChunkShape(32)), normals)
    surface = len(plain.positions)
    hanging: dict[int, set[int]] = {}
    for triangle in skirted.triangles[len(plain.triangles) :].tolist():
        for lower in (corner for corner in triangle if corner >= surface):
            hanging.setdefault(lower, set()).update(corner for corner in triangle if corner < surface)
    assert len(hanging) > 50
    for lower, owners in hanging.items():
        assert tuple(skirted.normals[lower]) in {tuple(skirted.normals[owner]) for owner in owners}


def in_air(wide, plain, skirted):
    """Return what share of places on skirts is in the air by more than a tenth of a cell.

    wide: samples with an apron as wide as skirts reach. A cell of density is the median gradient.
    """
    triangles = skirted.triangles[len(plain.triangles) :]
    corners = (skirted.positions[triangles, :3].astype(float) - POSITION_LOW) / wide.shape.units_per_cell
    shares = np.random.default_rng(1).dirichlet((1, 1, 1), (len(corners), 8))
    places = np.einsum("tsc,tcx->tsx", shares, corners).reshape(-1, 3)
    density = map_coordinates(wide.density, (places + wide.shape.apron)[:, [1, 2, 0]].T, order=1)
    slope = np.median(np.sqrt(sum(np.square(np.gradient(wide.density)))))
    return (density > slope / 10).mean()


@pytest.mark.parametrize("lod", [0, 2])
@pytest.mark.parametrize("name", ["hills", "planet", "terrain"])
def test_skirts_stay_in_the_rock_also_beyond_their_chunk(name, lod):
    recipe, shares = WorldRecipe(42, builtin(name)), []
    top = {"hills": 0, "terrain": 0, "planet": 6 >> lod}[name]
    for x, y, z in product((0, 1), (top - 1, top), (0, 1)):
        key = ChunkKey(lod, x, y, z)
        plain, skirted = both(sample(recipe, key, ChunkShape(32)))
        if len(skirted.triangles) > len(plain.triangles):
            shares.append(in_air(sample(recipe, key, ChunkShape(32, HEIGHT_CELLS + 1)), plain, skirted))
    assert len(shares) >= 3
    assert max(shares) <= IN_AIR_MAX


def test_skirts_end_where_the_rock_does():
    """A slab of three cells, in whose top and bottom a skirt would come out again."""
    across = np.abs(np.arange(-1, 34, dtype=np.float32)[:, None, None] - np.float32(15)) - np.float32(1.5)
    samples = Samples(ChunkShape(32), np.ascontiguousarray(np.broadcast_to(across, (35, 35, 35))))
    plain, skirted = both(samples)
    new = (skirted.positions[len(plain.positions) :, 1].astype(float) - POSITION_LOW) / samples.shape.units_per_cell
    assert 13.5 <= new.min() <= 14.5
    assert 15.5 <= new.max() <= 16.5


@pytest.mark.parametrize("name", VIEWS)
def test_skirts_cost_few_triangles(name):
    plain = skirted = 0
    for key in VIEWS[name]:
        pair = both(sample(WorldRecipe(42, builtin(name)), key, ChunkShape(32)))
        plain, skirted = plain + len(pair[0].triangles), skirted + len(pair[1].triangles)
    assert plain > 5_000
    assert plain < skirted <= (1 + COST_MAX) * plain


def test_a_skirt_hangs_down_from_a_plain():
    """A plane at a height of 16.5 cells: six cells deep on four faces, none on the two others."""
    shape = ChunkShape(32)
    height = np.arange(-1, 34, dtype=np.float32)[:, None, None] - np.float32(16.5)
    samples = Samples(shape, np.ascontiguousarray(np.broadcast_to(height, (35, 35, 35))))
    plain, skirted = both(samples)
    new = skirted.positions[len(plain.positions) :, :3].astype(int)
    assert set(new[:, 1]) == {POSITION_LOW + 1024 * 33 // 2 - HEIGHT_CELLS * 1024}
    skirts = len(skirted.triangles) - len(plain.triangles)
    assert 4 * 32 < skirts < 4 * 32 * 2, "some have one lower end for two vertices"
    corners, ends = np.unique(
        new[np.isin(new, (POSITION_LOW, POSITION_HIGH)).sum(axis=1) == 2], axis=0, return_counts=True
    )
    assert len(corners) == 4
    assert (ends == 2).all(), "where two faces meet, each skirt has an end of its own"
    a, b, c = (skirted.positions[skirted.triangles[len(plain.triangles) :, i], :3].astype(int) for i in range(3))
    turned = np.cross(b - a, c - a)
    outwards = (a + b + c) - 3 * (POSITION_LOW + POSITION_HIGH) // 2
    assert (np.einsum("ij,ij->i", turned * (turned != 0), outwards) > 0).all(), "seen from outside"


@pytest.mark.parametrize("value", [1, -1])
def test_nothing_to_hang_from(value):
    empty = Samples(ChunkShape(16), np.full((19, 19, 19), value, np.float32))
    assert extract(empty, skirts=True).is_empty
    ball = np.indices((19, 19, 19)) - 9.0
    inside = Samples(ChunkShape(16), (np.sqrt((ball**2).sum(axis=0)) - 5).astype(np.float32))
    plain, skirted = both(inside)
    assert np.array_equal(plain.triangles, skirted.triangles)
