"""How far a level's surface lies from that of LOD 0: one number for a recipe and a level, in voxels.

It is the 95th percentile, over the level's surface, of the distance to where the field of LOD 0 changes its sign; of
LOD 0 itself, what its triangles are off. Recipes come from strangers, so it is measured, at some places:

    find       a grid of samples of the level's field around the origin, wider and wider until the surface crosses it
    zoom       into some of the crossed cells, four times finer each time, down to the level's own cells
    measure    from a point of the surface in each of these: boxes of samples of LOD 0, wider and wider until one has
               both signs

Half of the places are the highest in their columns: in a world full of caves the ground would hardly count otherwise,
and the ground is what is seen. It is right within a factor of 2 (`tests/property/test_geometric_error.py`), and takes
some milliseconds.

All is drawn from one fixed sequence and worked out for one seed: like the generator token, the number belongs to the
recipe. Only + - * /, sqrt and comparisons, as in the field: it is the same on every machine.
"""

import math
import random
from functools import cache, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import densities
from chunkserver.grid import LATTICE_MAX
from chunkserver.recipe import WorldRecipe

PERCENTILE: Final = 0.95
PLACES: Final = 128
SEED: Final = 0
ERRORS_KEPT_MAX: Final = 2048
"""Recipes, each at a level, whose error is kept in one process."""

GRID_CELLS: Final = 16
ZOOM: Final = 4
GRID_FIRST: Final = 3
"""Cells of the first grid, as a power of `ZOOM`, in steps. What it does not see is small, or farther away."""

LEAST_STEPS: Final = 2.0**-10
"""The least error, in steps: what a vertex is rounded by. So a client can divide by it."""
GONE_STEPS: Final = 2.0
"""The error, in steps, of a level that shows nothing: what a level has lost is at most 4 steps wide."""
FAR_STEPS: Final = 32.0
"""Nothing is looked for farther away."""
REACH: Final = 2
"""Samples of a box on each side of the point."""
STEEP: Final = 4.0
"""How much the density is taken to change in a voxel at most, to begin near enough."""
EDGES_MAX: Final = 5
"""Crossed edges of a cell that surely has one piece of the surface: two pieces cross at least three each."""

_Doubles = NDArray[np.float64]
_Floats = NDArray[np.float32]
_Ints = NDArray[np.int64]
_Bools = NDArray[np.bool_]
_Bytes = NDArray[np.int8]

_CORNERS: Final[_Ints] = np.array([(number & 1, number >> 1 & 1, number >> 2) for number in range(8)])
_EDGES: Final[_Ints] = np.array([(low, low | bit) for bit in (1, 2, 4) for low in range(8) if not low & bit])
"""Of a cell: x y z of each corner, bits x = 1, y = 2, z = 4; and the corners that each edge joins."""
_LENGTHS: Final[_Doubles] = np.sqrt(((np.indices((2 * REACH + 1,) * 3) - REACH) ** 2).sum(axis=0)).reshape(-1)
_MIDDLE: Final = _LENGTHS.size // 2


def geometric_error(recipe: WorldRecipe, lod: int) -> float:
    """Return the geometric error of the chunks of `recipe` at level `lod`, voxels: above 0, the same for every seed.

    It has five significant bits: exact in float32, and short in decimal. Where the level shows no surface, or where
    none is found, it is `GONE_STEPS` steps. Raises `BadRecipe` as `sample` does.
    """
    return _measured(recipe.source, lod)


@lru_cache(maxsize=ERRORS_KEPT_MAX)
def _measured(source: str, lod: int) -> float:
    recipe, step, draw = WorldRecipe(SEED, source), float(1 << lod), random.Random(SEED)
    points = _points(recipe, lod, draw)
    distances = sorted(_distances(recipe, points, step).tolist())
    error = distances[math.ceil(PERCENTILE * len(distances)) - 1] if distances else GONE_STEPS * step
    mantissa, exponent = math.frexp(max(error, LEAST_STEPS * step))
    return math.ldexp(round(32 * mantissa) / 32, exponent)


def _points(recipe: WorldRecipe, lod: int, draw: random.Random) -> _Doubles:
    """Return points of the surface of a level, (n, 3), x y z, voxels; none if no surface is found."""
    low, spacing, crossings = _found(recipe, lod)
    if not crossings.any():
        return np.empty((0, 3))
    corners = low + spacing * _picked(crossings > 0, PLACES, draw)
    while spacing > ZOOM << lod:
        spacing /= ZOOM
        inside = _cubes(recipe, lod, corners, np.full(PLACES, spacing), ZOOM)
        corners = corners + spacing * _picked(_crossings(inside) > 0, PLACES, draw)
    step = float(1 << lod)
    density = _cubes(recipe, lod, corners, np.full(PLACES, step), ZOOM)
    crossings = _crossings(density)
    whole = (crossings > 0) & (crossings <= EDGES_MAX)
    kept = whole.any(axis=(1, 2, 3))
    cells = _picked(whole[kept], len(corners[kept]), draw)
    return corners[kept] + step * (cells + _in_cells(density[kept], cells, draw))


def _found(recipe: WorldRecipe, lod: int) -> tuple[_Doubles, float, _Bytes]:
    """Return the first corner, the spacing and the crossings of a grid around the origin.

    If no grid sees a surface, nothing is crossed in the one that is returned.
    """
    for power in (*range(GRID_FIRST, 0, -1), *range(GRID_FIRST + 1, LATTICE_MAX.bit_length())):
        spacing = float(ZOOM**power << lod)
        low = np.full((1, 3), -spacing * GRID_CELLS / 2)
        crossings = _crossings(_cubes(recipe, lod, low, np.array([spacing]), GRID_CELLS))
        if crossings.any() or low[0, 0] <= -LATTICE_MAX / ZOOM:
            break
    return low, spacing, crossings


def _cubes(recipe: WorldRecipe, lod: int, lows: _Doubles, spacings: _Doubles, cells: int) -> _Floats:
    """Return a level's densities over cubes of so many cells a side, (n, y, z, x).

    lows: (n, 3), x y z of the first point of each, voxels. spacings: (n,), between its points, voxels.
    """
    points = lows[:, None] + spacings[:, None, None] * _steps(cells)
    return densities(recipe, lod, points.reshape(-1, 3)).reshape(-1, *(cells + 1,) * 3)


@cache
def _steps(cells: int) -> _Doubles:
    """Return the points of a cube of so many cells a side, in cells from its low corner: (points, 3), x y z."""
    y, z, x = np.indices((cells + 1,) * 3, np.float64).reshape(3, -1)
    return np.stack((x, y, z), axis=-1)


def _crossings(density: _Floats) -> _Bytes:
    """Return how many edges of each cell are crossed, (n, y, z, x), of densities (n, y, z, x)."""
    rock = density < 0
    first, *others = (_around(np.diff(rock, axis=axis).view(np.int8), axis) for axis in (1, 2, 3))
    return first + others[0] + others[1]


def _around(edges: _Bytes, along: int) -> _Bytes:
    """Return the sum of the four edges of each cell, of all edges along an axis."""
    for across in {1, 2, 3} - {along}:
        lines = np.moveaxis(edges, across, 0)
        edges = np.moveaxis(lines[:-1] + lines[1:], 0, across)
    return edges


def _picked(allowed: _Bools, count: int, draw: random.Random) -> _Ints:
    """Return `count` cells, (count, 3), x y z, of cubes: one of each, or all of the only one. Each cube allows some.

    Every other one is the highest of its column.
    """
    passed = allowed.reshape(len(allowed), -1).cumsum(axis=1)
    wanted = _drawn(draw, count, 1) * passed[:, -1:]
    y, z, x = np.unravel_index((passed > np.floor(wanted)).argmax(axis=1), allowed.shape[1:])
    number = np.arange(count)
    columns = np.broadcast_to(allowed, (count, *allowed.shape[1:]))[number, :, z, x]
    highest = allowed.shape[1] - 1 - columns[:, ::-1].argmax(axis=1)
    return np.stack((x, np.where(number % 2 == 0, y, highest), z), axis=1)


def _in_cells(density: _Floats, cells: _Ints, draw: random.Random) -> _Doubles:
    """Return a point of the surface in a cell of each cube, (n, 3), x y z, in cells from its low corner.

    It lies in a triangle between three of the places where edges are crossed.
    """
    x, y, z = (cells[:, None] + _CORNERS).transpose(2, 0, 1)
    values = density[np.arange(len(cells))[:, None], y, z, x].astype(np.float64)
    one, other = values[:, _EDGES[:, 0]], values[:, _EDGES[:, 1]]
    crossed = (one < 0) != (other < 0)
    share = one / np.where(crossed, one - other, 1.0)
    ends = _CORNERS[_EDGES]
    places = ends[:, 0] + share[:, :, None] * (ends[:, 1] - ends[:, 0])
    order = np.argsort(np.where(crossed, _drawn(draw, len(cells), len(_EDGES)), 1.0), axis=1, kind="stable")
    a, b, c = np.take_along_axis(places, order[:, :3, None], axis=1).transpose(1, 0, 2)
    along, across = np.sqrt(_drawn(draw, len(cells), 1)), _drawn(draw, len(cells), 1)
    point: _Doubles = a + along * ((b - a) + across * (c - b))
    return point


def _drawn(draw: random.Random, count: int, each: int) -> _Doubles:
    return np.array([draw.random() for _ in range(count * each)]).reshape(count, each)


def _distances(recipe: WorldRecipe, points: _Doubles, step: float) -> _Doubles:
    """Return how far the nearest change of sign of LOD 0 is from each point, (n,) voxels: `FAR_STEPS` at most.

    It is the shortest of the straight ways to samples around of the other sign, with the density even along each.
    """
    here = np.abs(densities(recipe, 0, points))
    spacings = np.maximum(here.astype(np.float64) / (STEEP * REACH), LEAST_STEPS * step)
    distances = np.full(len(points), FAR_STEPS * step)
    left = np.flatnonzero(spacings < distances)
    while left.size:
        spacing = spacings[left]
        lows = points[left] - REACH * spacing[:, None]
        density = _cubes(recipe, 0, lows, spacing, 2 * REACH).reshape(left.size, -1).astype(np.float64)
        middle = density[:, _MIDDLE, None]
        other = (density < 0) != (middle < 0)
        ways = np.where(other, _LENGTHS * (middle / np.where(other, middle - density, 1.0)), np.inf).min(axis=1)
        distances[left] = np.minimum(distances[left], ways * spacing)
        spacings[left] *= 2
        left = left[np.isinf(ways) & (spacings[left] < FAR_STEPS * step)]
    return distances
