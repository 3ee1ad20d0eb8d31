"""No crack at any level of detail: chunks of several levels, welded by exact equality."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import CELLS_DEFAULT, LATTICE_MAX, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh
from chunkserver.mesher import extract
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.samples import Samples, coarse_box
from tests.octrees import FIELDS, Octree, chunks_of, deep_octree, random_octree, samples_of
from tests.scale import TORTURE, count
from tests.surfaces import CHUNK_UNITS, Surface, assert_closed, doubled_areas, edges_of, on_border, weld

CELLS = 16


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("levels", [2, 3, 4])
def test_octrees_are_closed(name, levels):
    finest = levels
    for seed in range(1, 1 + count(100)):
        tree = random_octree(np.random.default_rng(seed), levels, 0.2)
        finest = min(finest, *(key.lod for key in tree.leaves))
        assert_closed(weld(chunks_of(tree, FIELDS[name](seed), CELLS)))
    assert finest == 0, "no octree of all levels"


@pytest.mark.parametrize("levels", [3, 4])
def test_octrees_of_full_size_are_closed(levels):
    for seed in range(4, 4 + count(25)):  # those first have 29 and 43 leaves
        name = list(FIELDS)[(seed + 2) % len(FIELDS)]
        tree = deep_octree(np.random.default_rng(seed), levels)
        assert {key.lod for key in tree.leaves} == set(range(levels))
        assert_closed(weld(chunks_of(tree, FIELDS[name](seed), CELLS_DEFAULT)))


FAR = LATTICE_MAX // CELLS // 2


@pytest.mark.parametrize("low", [(-1, -1, -1), (-FAR, -2, FAR - 2), (FAR - 2, FAR - 2, -FAR)])
def test_octrees_are_closed_around_the_origin_and_at_the_ends_of_the_world(low):
    tree = random_octree(np.random.default_rng(5), 2, 0.4, low)
    assert len(tree.leaves) > 8
    assert_closed(weld(chunks_of(tree, FIELDS["another noise"](1), CELLS)))


def open_edges(surface: Surface) -> int:
    ends, _, balance = edges_of(surface)
    return int(((balance != 0) & ~on_border(surface, ends)).sum())


@pytest.mark.parametrize("name", FIELDS)
def test_without_a_mask_they_are_open(name):
    tree = Octree(1)
    tree.split(ChunkKey(1, 0, 0, 0))
    assert open_edges(weld(chunks_of(tree, FIELDS[name](3), CELLS, masked=False))) > 10


def built(recipe: WorldRecipe, tree: Octree) -> list[tuple[ChunkKey, Mesh]]:
    """Return the chunks of all leaves, through the field's own levels and its samples of the next one."""
    shape = ChunkShape(CELLS)
    return [(key, extract(sample(recipe, key, shape, tree.coarser(key)))) for key in tree.leaves]


LOWS = {"planet": (-1, 2, -1), "continents": (-1, 155, -1), "moon": (-8, -1, -1), "ring": (-12, -1, -1)}
"""Of an octree of three levels from LOD 0 on, where the origin has nothing to see."""


@pytest.mark.parametrize("name", BUILTINS)
@pytest.mark.parametrize("finest", [0, 5])
def test_built_in_recipes_are_closed(name, finest):
    """Three levels: LODs 0 to 2, or 5 to 7."""
    recipe = WorldRecipe(3, builtin(name))
    tree = random_octree(
        np.random.default_rng(1), 3, 0.3, LOWS.get(name, (-1, -1, -1)) if not finest else (-1,) * 3, finest
    )
    assert {key.lod - finest for key in tree.leaves} == {0, 1, 2}
    chunks = built(recipe, tree)
    assert_closed(weld(chunks))
    assert finest or sum(not mesh.is_empty for _, mesh in chunks) > 3


QUARTER = LATTICE_MAX // 4 // (2 * CELLS)
"""Chunks of LOD 1 from the origin to 2**38 voxels."""


@pytest.mark.parametrize(
    ("name", "low"),
    [
        ("caves", (QUARTER, -QUARTER, QUARTER)),
        ("caves", (-QUARTER, QUARTER, -QUARTER)),
        ("terrain", (QUARTER, -1, -QUARTER)),
        ("terrain", (-QUARTER, -1, QUARTER)),
    ],
)
def test_built_in_recipes_are_closed_far_from_the_origin(name, low):
    tree = random_octree(np.random.default_rng(5), 2, 0.4, low)
    chunks = built(WorldRecipe(3, builtin(name)), tree)
    assert_closed(weld(chunks))
    assert sum(not mesh.is_empty and tree.coarser(key) > 0 for key, mesh in chunks) > 3


def blocks(rng, mask):
    """Yield 27 places, each with whether it is coarse and a mask: the one in the middle is fine, with this mask."""
    coarse = rng.random((3, 3, 3)) < 0.5
    coarse[1, 1, 1] = False
    for face in range(6):
        middle = [1, 1, 1]
        middle[face // 2] += 1 if face & 1 else -1
        coarse[tuple(middle)] = mask >> face & 1
    for place in product(range(3), repeat=3):
        found = 0
        for face in range(6):
            beside = list(place)
            beside[face // 2] += 1 if face & 1 else -1
            inside = 0 <= beside[face // 2] < 3
            found |= bool(inside and not coarse[place] and coarse[tuple(beside)]) << face
        yield place, bool(coarse[place]), found


def waves(rng, side):
    """Return waves longer than ten samples, and a little noise."""
    at = np.indices((side,) * 3) * rng.uniform(0.2, 0.6, (3, 1, 1, 1)) + rng.uniform(0, 6, (3, 1, 1, 1))
    return (np.sin(at).sum(axis=0) + 0.2 * rng.uniform(-1, 1, (side,) * 3)).astype(np.float32)


def cut(density, low, shape):
    slices = tuple(slice(low[axis], low[axis] + n) for axis, n in zip((1, 2, 0), shape, strict=True))
    return np.ascontiguousarray(density[slices])


def low_octant(mesh):
    """Return the part of a mesh that lies in the low half on each axis, as wide as a whole chunk."""
    places = mesh.positions.astype(np.int64)
    inside = (places[:, :3] <= POSITION_LOW + CHUNK_UNITS // 2).all(axis=1)
    wide = np.where(inside[:, None], 2 * places - POSITION_LOW, POSITION_LOW).astype(np.uint16)
    return Mesh(mesh.content, wide, mesh.normals, mesh.triangles[inside[mesh.triangles].all(axis=1)])


def test_all_masks_among_neighbours_of_both_levels(rng):
    """27 blocks of 32 voxels: chunks of LOD 0, and eighths of chunks of LOD 1."""
    shape = ChunkShape(32)
    if TORTURE:
        fine, coarse = (rng.uniform(-1, 1, (side,) * 3).astype(np.float32) for side in (99, 67))
    else:
        fine, coarse = waves(rng, 99), waves(rng, 67)

    @cache
    def mesh(place, is_coarse, mask):
        if is_coarse:
            return low_octant(extract(Samples(shape, cut(coarse, [16 * at for at in place], (35,) * 3))))
        density = cut(fine, [32 * at for at in place], (35,) * 3)
        if not mask:
            return extract(Samples(shape, density))
        box = coarse_box(32, mask)
        there = cut(coarse, [16 * at + 1 + low for at, low in zip(place, box.low, strict=True)], box.shape)
        return extract(Samples(shape, density, mask, there))

    for mask in range(64):
        found = list(blocks(rng, mask))
        assert ((1, 1, 1), False, mask) in found
        assert_closed(weld((ChunkKey(0, *place), mesh(place, is_coarse, own)) for place, is_coarse, own in found))


def on_faces(mesh):
    places = mesh.positions[:, :3].astype(np.int64) - POSITION_LOW
    rows = (places % CHUNK_UNITS == 0).any(axis=1)
    return Mesh(mesh.content, mesh.positions[rows], mesh.normals[rows], mesh.triangles[:0])


def clashes(chunks):
    """Return (where, in units of the finest level) vertices in one place have two normals, and how many are shared.

    Of those on faces of chunks: what has made room is in no other chunk, and two of those may meet.
    """
    pairs = [(key, on_faces(mesh)) for key, mesh in chunks if not mesh.is_empty]
    places = np.concatenate(
        [
            (mesh.positions[:, :3].astype(np.int64) - POSITION_LOW + np.array(key[1:]) * CHUNK_UNITS) << key.lod
            for key, mesh in pairs
        ]
    )
    normals = np.concatenate([mesh.normals[:, :3].astype(np.float64) for _, mesh in pairs])
    unique, place, times = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    first = np.empty((len(unique), 3))
    first[place.reshape(-1)] = normals
    return unique[np.unique(place.reshape(-1)[(first[place.reshape(-1)] != normals).any(axis=1)])], int(
        (times > 1).sum()
    )


@pytest.mark.parametrize("normals", ["int8", "float32"])
@pytest.mark.parametrize("name", FIELDS)
def test_equal_positions_have_equal_normals(name, normals):
    """But where a fine and a coarse crossing coincide on a line that chunks of both levels share."""
    shared = 0
    for seed in range(count(200)):
        tree = random_octree(np.random.default_rng(seed), 2, 0.3)
        where, more = clashes(chunks_of(tree, FIELDS[name](seed), CELLS, normals=normals))
        shared += more
        assert ((where % CHUNK_UNITS == 0).sum(axis=1) >= 2).all(), where[:3]
        assert len(where) <= more / 100
    assert shared > 100 or name == "planes"


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("mask", [1, 10, 37, 63])
def test_no_triangle_is_degenerate_when_it_has_made_room(name, mask):
    """Those of regular cells have an area; those of transition cells have three corners in three places."""
    for seed in range(count(300)):
        key, shape = ChunkKey(0, 1, 1, 1), ChunkShape(CELLS)
        regular = len(extract(samples_of(FIELDS[name](seed), key, shape, 0)).triangles)
        surface = weld([(key, extract(samples_of(FIELDS[name](seed), key, shape, mask)))])
        assert (doubled_areas(surface)[:regular] != 0).any(axis=1).all()
        a, b, c = surface.triangles[regular:].T
        assert not ((a == b) | (b == c) | (c == a)).any()
