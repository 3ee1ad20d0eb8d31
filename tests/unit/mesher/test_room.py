"""Room for transition cells: who moves, how far, and what stays as it was."""

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.mesher.room import SLIDE_CELLS, make_room
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples, coarse_box
from tests.scale import count

SHAPE = ChunkShape(32)
UNITS = SHAPE.units_per_cell


def pair(samples, mask):
    """Return a chunk's plain mesh, and its positions when it has made room."""
    mesh = extract(Samples(samples.shape, samples.density), normals="float32")
    moved = mesh.positions.copy()
    nothing = np.zeros(coarse_box(samples.shape.cells, mask).shape, np.float32)
    make_room(Samples(samples.shape, samples.density, mask, nothing), moved, mesh.triangles.astype(np.uint32))
    return mesh, moved


def plane(normal, offset):
    """Return the samples of a plane through cell units (x, y, z): normal . place = offset."""
    y, z, x = np.indices((SHAPE.samples,) * 3) - SHAPE.apron
    return Samples(SHAPE, (normal[0] * x + normal[1] * y + normal[2] * z - offset).astype(np.float32))


def cross(positions, triangles):
    a, b, c = (positions[:, :3].astype(np.int64)[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def distances(positions):
    """Return how far each vertex is from each face of the chunk, in the order of a mask's bits; units."""
    places = positions[:, :3].astype(np.int64)
    return np.stack([places - POSITION_LOW, POSITION_HIGH - places], 2).reshape(len(places), 6)


WORLDS = [("hills", 0, (0, -1, 0)), ("planet", 2, (1, 0, -1)), ("sphere", 0, (1, 0, -1)), ("caves", 0, (3, -1, 2))]


def sampled(name, lod, place):
    return sample(WorldRecipe(7, builtin(name)), ChunkKey(lod, *place), SHAPE)


def noise(rng):
    return Samples(SHAPE, rng.uniform(-1, 1, (SHAPE.samples,) * 3).astype(np.float32))


@pytest.mark.parametrize("world", [*WORLDS, None])
@pytest.mark.parametrize("mask", [1, 8, 22, 41, 63])
def test_who_moves_and_how_far(world, mask, rng):
    mesh, moved = pair(sampled(*world) if world else noise(rng), mask)
    before, after = distances(mesh.positions), distances(moved)
    masked = np.array([mask >> face & 1 for face in range(6)], bool)
    near = masked & (before < UNITS)
    has_moved = (moved != mesh.positions).any(axis=1)
    assert has_moved.sum() > 20
    assert not has_moved[~near.any(axis=1) | (before[:, ~masked] == 0).any(axis=1)].any()
    step = (moved.astype(np.int64) - mesh.positions)[:, :3]
    assert np.sqrt((step**2).sum(axis=1)).max() <= SLIDE_CELLS * UNITS + 2
    assert (after >= before)[near].all()
    assert (after[has_moved][:, ~masked] > 0).all()
    assert (moved[:, 3] == mesh.positions[:, 3]).all()


@pytest.mark.parametrize(("name", "lod", "place"), WORLDS)
@pytest.mark.parametrize("mask", [1, 8, 22, 41, 63])
def test_no_triangle_is_inverted(name, lod, place, mask):
    """By the normals of its corners; where a plain mesh has none, none of its triangles is inverted by its room."""
    mesh, moved = pair(sampled(name, lod, place), mask)
    up = mesh.normals[mesh.triangles].sum(axis=1)
    assert ((cross(mesh.positions, mesh.triangles) * up).sum(axis=1) > 0).all()
    assert ((cross(moved, mesh.triangles.astype(np.uint32)) * up).sum(axis=1) > 0).all()


@pytest.mark.parametrize("mask", [2, 12, 63])
def test_no_triangle_turns_by_60_degrees(mask, rng):
    """On white noise too, where triangles have any shape."""
    for _ in range(count(200)):
        mesh, moved = pair(noise(rng), mask)
        old, new = (cross(positions, mesh.triangles).astype(float) for positions in (mesh.positions, moved))
        cosine = (old * new).sum(axis=1) / np.sqrt((old**2).sum(axis=1) * (new**2).sum(axis=1))
        assert cosine.min() > 0.5
        assert (moved != mesh.positions).any()


@pytest.mark.parametrize(
    "normal", [(0.6, 0.8, 0.0), (0.0, 0.3, 0.9), (2.0, -1.0, 1.5), (0.2, 1.0, 0.1), (1.0, 0.0, 0.0)]
)
@pytest.mark.parametrize("mask", [1, 4, 38, 63])
def test_a_plane_stays_a_plane(normal, mask):
    mesh, moved = pair(plane(normal, 16.3 * sum(normal)), mask)
    length = np.sqrt(np.square(normal).sum())
    for positions in (mesh.positions, moved):
        off = (positions[:, :3].astype(float) - POSITION_LOW) @ normal / length - UNITS * 16.3 * sum(normal) / length
        assert abs(off).max() < 2


def test_a_vertex_goes_as_far_from_its_face_as_it_has_to():
    """A plane at 45 degrees to the face: d cells from it become d + (1 - d) / 4, half of it sideways."""
    mesh, moved = pair(plane((1.0, 1.0, 0.0), 20.3), 1)
    distance = mesh.positions[:, 0].astype(int) - POSITION_LOW
    inner = (distance < UNITS) & (mesh.positions[:, 2] > POSITION_LOW) & (mesh.positions[:, 2] < POSITION_HIGH)
    assert inner.sum() > 30
    wanted = distance + np.maximum(UNITS - distance, 0) / 4
    assert abs(moved[inner, 0].astype(int) - POSITION_LOW - wanted[inner]).max() <= 1


def test_the_order_of_triangles_does_not_matter(rng):
    samples = noise(rng)
    mesh, moved = pair(samples, 63)
    again = mesh.positions.copy()
    nothing = np.zeros(coarse_box(32, 63).shape, np.float32)
    make_room(Samples(SHAPE, samples.density, 63, nothing), again, rng.permutation(mesh.triangles.astype(np.uint32)))
    assert np.array_equal(moved, again)


def test_nothing_moves_where_all_faces_around_are_not_masked():
    """A plane in a face's own layer, seen by the face across."""
    mesh, moved = pair(plane((1.0, 0.0, 0.0), 0.4), 2)
    assert np.array_equal(mesh.positions, moved)
    mesh, moved = pair(plane((1.0, 0.0, 0.0), 0.4), 1)
    assert np.array_equal(mesh.positions, moved)  # it lies along its face: there is no way along it


def inverted_area(samples):
    """Return the area of transition triangles against the normals of their corners, and of all of them."""
    regular = len(extract(Samples(samples.shape, samples.density)).triangles)
    mesh = extract(samples, normals="float32")
    if mesh.is_empty:
        return 0.0, 0.0
    found = cross(mesh.positions, mesh.triangles[regular:]).astype(float)
    area = np.sqrt((found**2).sum(axis=1))
    return area[(found * mesh.normals[mesh.triangles[regular:]].sum(axis=1)).sum(axis=1) < 0].sum(), area.sum()


def test_transition_triangles_of_a_smooth_shape_are_not_inverted():
    """Where both levels have the same field: 1 in 1,000 of their area at most."""
    recipe, areas = WorldRecipe(7, builtin("sphere")), []
    for x, y, z in np.ndindex(4, 4, 4):
        for mask in (21, 42, 26):
            samples = sample(recipe, ChunkKey(0, x - 2, y - 2, z - 2), SHAPE, mask)
            areas.append(inverted_area(samples))
    inverted, whole = np.sum(areas, axis=0)
    assert whole > 100 * UNITS**2
    assert inverted <= whole / 1000


@pytest.mark.parametrize("name", ["hills", "planet"])
@pytest.mark.parametrize("lod", [0, 1, 2])
def test_inverted_transition_triangles_are_as_few_as_published(name, lod):
    """In docs/CONVENTIONS.md: where levels differ, a closed surface faces the air below rock."""
    areas = []
    for seed in (3, 7, 42):
        rng, recipe = np.random.default_rng(seed), WorldRecipe(seed, builtin(name))
        for _ in range(30):
            if name == "planet":
                way = rng.normal(size=3)
                place = np.floor(200 * way / np.sqrt((way**2).sum()) / (32 << lod)).astype(int)
            else:
                place = rng.integers((-4, -1, -4), (4, 1, 4))
            mask = sum(int(rng.choice([0, 1, 2])) << 2 * axis for axis in range(3))
            x, y, z = place.tolist()
            if mask:
                areas.append(inverted_area(sample(recipe, ChunkKey(lod, x, y, z), SHAPE, mask)))
    inverted, whole = np.sum(areas, axis=0)
    assert 0 < inverted <= 0.265 * whole
