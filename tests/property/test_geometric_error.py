"""The stated geometric error beside an honest one: exact distances from a level's mesh to the triangles of LOD 0."""

import json
import math
from collections.abc import Iterable
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from trimesh.triangles import closest_point

from chunkserver.field import prove
from chunkserver.geometric_error import GONE_STEPS, LEAST_STEPS, geometric_error
from chunkserver.grid import LOD_MAX, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from tests.scale import TORTURE
from tests.worlds import chunk_mesh

FACTOR = 2.0
SEED = 5
CELLS = 32
LEVELS = range(1, 7)
COLUMNS = (4, 16, 64)
"""Chunks from the origin to where columns of chunks are drawn, at most."""
HEIGHT_MAX = 16
"""Chunks from the origin to the top and to the bottom of a column."""
TRIES_MAX = 4000
COUNT = 80 if TORTURE else 5
POINTS = 12
"""How many columns, and points of each."""
RADII = {"continents": 10_000}
"""Voxels: of a ball so large that at the origin there is only rock. Columns are anywhere on it, and more of them: it is
not everywhere alike."""
COUNT_ON_BALL = max(COUNT, 30)
RADIUS_FIRST = 3.0
EDGE_MAX = 3.5
"""Voxels: what a triangle of LOD 0 reaches around its middle, twice."""
MAGNIFIED = 8

Triangles = NDArray[np.float64]


def triangles_of(recipe: WorldRecipe, key: ChunkKey) -> Triangles:
    """Return the corners of a chunk's triangles, (T, 3, 3) voxels."""
    if prove(recipe, key, ChunkShape(CELLS)):
        return np.empty((0, 3, 3))
    mesh = chunk_mesh(recipe, key, CELLS)
    corners = np.array(key.low_corner(CELLS)) + (mesh.positions[:, :3] - float(POSITION_LOW)) * (
        CELLS * key.step / 2**15
    )
    found: Triangles = corners[mesh.triangles]
    return found


def spread(triangles: Triangles, rng: np.random.Generator) -> Triangles:
    """Return points spread evenly over the area of triangles."""
    a, b, c = triangles.transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    at = rng.choice(len(areas), POINTS, p=areas / areas.sum())
    u, v = np.sqrt(rng.random((POINTS, 1))), rng.random((POINTS, 1))
    return np.asarray((1 - u) * a[at] + u * (1 - v) * b[at] + u * v * c[at])


def from_above(triangles: Triangles, low: NDArray[np.float64], side: int, rng: np.random.Generator) -> Triangles:
    """Return the highest points of triangles over places spread evenly over a square of the ground."""
    a, b, c = triangles.transpose(1, 0, 2)
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    area = ux * vz - uz * vx
    area[area == 0] = np.inf  # a wall: nothing is over a place that it hides
    highest = []
    for x, z in low[[0, 2]] + side * rng.random((POINTS, 2)):
        px, pz = x - a[:, 0], z - a[:, 2]
        s, t = (px * vz - pz * vx) / area, (ux * pz - uz * px) / area
        over = (s >= 0) & (t >= 0) & (s + t <= 1) & np.isfinite(area)
        if over.any():
            highest.append((x, (a[:, 1] + s * uy + t * vy)[over].max(), z))
    return np.array(highest).reshape(-1, 3)


def on_ball(radius: int, lod: int, rng: np.random.Generator) -> tuple[int, int, int]:
    """Return a chunk at which the surface of a ball is, (x, y, z)."""
    at = rng.normal(size=3)
    x, y, z = (radius * at / np.linalg.norm(at) // (CELLS << lod)).astype(int).tolist()
    return x, y, z


def seen(recipe: WorldRecipe, lod: int, rng: np.random.Generator, radius: int | None = None) -> Triangles:
    """Return points of columns of chunks: evenly over the surface of some, as seen from above of as many others.

    radius: of the ball that the columns are on, voxels; else they are around the origin.
    """
    points: list[Triangles] = []
    for turn in range(TRIES_MAX):
        reach = COLUMNS[turn % len(COLUMNS)]
        x, z = rng.integers(-reach, reach, 2).tolist()
        x, y, z = (x, 0, z) if radius is None else on_ball(radius, lod, rng)
        heights = range(y - min(reach, HEIGHT_MAX), y + min(reach, HEIGHT_MAX))
        column = np.concatenate([triangles_of(recipe, ChunkKey(lod, x, height, z)) for height in heights])
        if not len(column):
            continue
        low, side = np.array(ChunkKey(lod, x, 0, z).low_corner(CELLS), float), CELLS << lod
        points.append(from_above(column, low, side, rng) if len(points) % 2 else spread(column, rng))
        if len(points) == (COUNT if radius is None else COUNT_ON_BALL):
            break
    return np.concatenate(points)


class Surface:
    """The surface of LOD 0, chunk by chunk as far as it is needed."""

    def __init__(self, recipe: WorldRecipe) -> None:
        self._recipe = recipe
        self._chunks: dict[tuple[int, ...], Triangles] = {}

    def distance(self, point: NDArray[np.float64]) -> float:
        """Return the exact distance to the nearest triangle."""
        radius = RADIUS_FIRST
        while True:
            near = np.concatenate([self._chunk(place) for place in self._around(point, radius)])
            if len(near):
                reach = np.linalg.norm(near.mean(axis=1) - point, axis=1)
                close = near[reach <= reach.min() + EDGE_MAX]
                found = np.linalg.norm(
                    closest_point(close, np.broadcast_to(point, (len(close), 3))) - point, axis=1
                ).min()
                if found <= radius:
                    return float(found)
            radius *= 2

    @staticmethod
    def _around(point: NDArray[np.float64], radius: float) -> Iterable[tuple[int, ...]]:
        ends = np.floor((point - radius) / CELLS).astype(int), np.floor((point + radius) / CELLS).astype(int)
        return product(*(range(low, high + 1) for low, high in zip(*ends, strict=True)))

    def _chunk(self, place: tuple[int, ...]) -> Triangles:
        if place not in self._chunks:
            self._chunks[place] = triangles_of(self._recipe, ChunkKey(0, *place))
        return self._chunks[place]


def measured(name: str, lod: int) -> float:
    """Return the 95th percentile of the distances of points of a level of a built-in from LOD 0, voxels."""
    recipe = WorldRecipe(SEED, builtin(name))
    points, surface = seen(recipe, lod, np.random.default_rng(lod), RADII.get(name)), Surface(recipe)
    return float(np.percentile([surface.distance(point) for point in points], 95))


def shown(name: str, lod: int) -> bool:
    """Whether anything of a built-in is left at a level."""
    return bool(geometric_error(WorldRecipe(SEED, builtin(name)), lod) != GONE_STEPS * 2**lod)


@pytest.mark.parametrize(("number", "name"), [*enumerate(BUILTINS)])
def test_it_is_right_within_a_factor_of_2(number: int, name: str):
    recipe = WorldRecipe(SEED, builtin(name))
    levels = [lod for lod in LEVELS if shown(name, lod)]
    for lod in levels if TORTURE else [levels[number % len(levels)]]:
        stated, honest = geometric_error(recipe, lod), measured(name, lod)
        assert honest / FACTOR <= stated <= max(FACTOR * honest, LEAST_STEPS * 2**lod), (lod, stated, honest)


@pytest.mark.parametrize("name", BUILTINS if TORTURE else ["hills"])
def test_the_error_of_lod_0_is_that_of_its_triangles(name: str):
    """Beside a mesh that is eight times finer: of the same world magnified."""
    recipe = WorldRecipe(SEED, builtin(name))
    expression = {"op": "scale", "a": json.loads(recipe.source), "factor": [MAGNIFIED] * 3}
    fine = Surface(WorldRecipe(SEED, canonical(expression)))
    points = seen(recipe, 0, np.random.default_rng(9))
    honest = float(np.percentile([fine.distance(MAGNIFIED * point) for point in points], 95)) / MAGNIFIED
    stated = geometric_error(recipe, 0)
    assert honest / FACTOR <= stated <= max(FACTOR * honest, LEAST_STEPS), (stated, honest)


def errors(recipe: object, seed: int = 0) -> list[float]:
    world = WorldRecipe(seed, canonical(recipe))
    return [geometric_error(world, lod) for lod in range(LOD_MAX + 1)]


@pytest.mark.parametrize("name", ["hills", "planet"])
def test_a_client_can_divide_by_it_and_float32_holds_it(name: str):
    found = errors(name)
    assert found == errors(name, seed=-3)
    assert all(error >= LEAST_STEPS * 2**lod for lod, error in enumerate(found))
    assert [float(np.float32(error)) for error in found] == found
    assert all((math.frexp(error)[0] * 32).is_integer() for error in found)


def test_a_floor_is_off_by_what_its_vertices_are_rounded_by():
    assert errors("plane") == [2.0 ** (lod - 10) for lod in range(LOD_MAX + 1)]


@pytest.mark.parametrize("recipe", [1, -1])
def test_a_world_without_a_surface(recipe: float):
    assert errors(recipe) == [GONE_STEPS * 2**lod for lod in range(LOD_MAX + 1)]


def test_where_a_level_has_lost_all():
    assert errors("sphere")[4] < GONE_STEPS * 2**4
    assert errors("sphere")[5:] == [GONE_STEPS * 2**lod for lod in range(5, LOD_MAX + 1)]


@pytest.mark.parametrize("radius", [48.0, 6_400_000.0, 2.0**30])
def test_a_ball_is_cut_by_the_sagitta_of_a_cell(radius: float):
    """A chord of length c is c^2 / 8 radius away from its arc in the middle."""
    for lod, error in enumerate(errors({"op": "sphere", "radius": radius})):
        if radius >= 2**lod * 8:
            least, sagitta = LEAST_STEPS * 2**lod, 4**lod / radius / 8
            assert max(least, 0.4 * sagitta) <= error <= max(least, 3 * sagitta), lod


@pytest.mark.parametrize("place", [[100, 100, 100], [-300, 40, 7], [0, -6_400_000, 0]])
def test_what_lies_beside_the_origin_is_found(place: list[float]):
    radius = max(20.0, abs(place[1]))
    found = geometric_error(WorldRecipe(0, canonical({"op": "sphere", "center": place, "radius": radius})), 0)
    assert found < 0.1


def test_a_surface_in_pieces_has_an_error_too():
    noise = {"op": "value3", "frequency": 1.0}
    assert 0 < errors(noise)[0] < GONE_STEPS
