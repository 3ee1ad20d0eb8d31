"""From a recipe and a chunk key to the samples of that chunk, apron included; or to the proof that none are needed."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.flatten import flatten
from chunkserver.field.intervals import ALL_FINITE, bounds_of_box
from chunkserver.field.points import densities_at, run_box
from chunkserver.field.skipping import WORTH, run_near_surface
from chunkserver.grid import ChunkKey, ChunkShape, check_key, check_shape
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples, coarse_box

Place = tuple[int, int, int]
"""A lattice point: x, y, z, voxels."""


def sample(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Samples:
    """Return the densities of chunk `key`, band-limited to its level, every sample worked out anew.

    coarser: mask of the faces whose neighbour is one level coarser: there the next level's field is sampled too.

    Each sample depends on its lattice point, the recipe and the level alone, so chunks that share a point agree to the
    bit (`tests/property/test_field_neighbours.py`).

    Raises `BadKey` for a key outside the world, `BadParameter` for a shape that is not built, `BadRecipe` for a recipe
    that passes a limit or is not finite all over the world. An empty chunk is no error.
    """
    first = _first(key, shape)
    side = shape.samples
    density = _sample(recipe, key.lod, first, (side, side, side))
    return _beside_coarse(recipe, key, shape, coarser, density)


def sample_near_surface(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Samples:
    """Return what `sample` returns, but for the values of samples that no vertex or triangle depends on.

    Of those the sign alone is right. What reads values apart from crossed edges, their ends' neighbours, and the faces
    of `coarser`, wants `sample`. Raises what `sample` raises.
    """
    flat, first = flatten(recipe, key.lod), _first(key, shape)
    low, step, side = np.array(first, float), float(key.step), shape.samples
    if flat.cost < WORTH:
        density = run_box(flat.tape, low, step, (side, side, side))
    else:
        density = run_near_surface(flat, low, step, side, shape.apron, coarser)
    return _beside_coarse(recipe, key, shape, coarser, density)


def _beside_coarse(
    recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int, density: NDArray[np.float32]
) -> Samples:
    """Return a chunk's densities together with those of the next level that its mask takes."""
    if not coarser:
        return Samples(shape, density)
    return Samples(shape, density, coarser, _sample(recipe, key.lod + 1, *_coarse_box(key, shape, coarser)))


def _sample(recipe: WorldRecipe, lod: int, first: Place, shape: tuple[int, int, int]) -> NDArray[np.float32]:
    """Return a level's densities over a box of its lattice points, whose first is given; shape: (y, z, x)."""
    return run_box(flatten(recipe, lod).tape, np.array(first, float), float(1 << lod), shape)


def densities(recipe: WorldRecipe, lod: int, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a level's densities at points anywhere in the world.

    points: (n, 3) float64, x y z, voxels.

    Returns (n,) float32, voxels, negative = rock, else air: at a lattice point to the bit what `sample` gives. Raises
    `BadRecipe` as `sample` does.
    """
    return densities_at(flatten(recipe, lod).tape, float(1 << lod), points)


def prove(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Literal["air", "rock"] | None:
    """Return what all samples of chunk `key` are, apron included, if bounds of the field show it; None if they do not.

    coarser: as in `sample`; then the next level's samples are among them.

    Takes microseconds, where sampling takes hundreds. Raises what `sample` raises.
    """
    side = shape.samples
    proven = _prove(recipe, key.lod, _first(key, shape), (side, side, side))
    if proven and coarser and _prove(recipe, key.lod + 1, *_coarse_box(key, shape, coarser)) != proven:
        return None
    return proven


def _prove(recipe: WorldRecipe, lod: int, first: Place, shape: tuple[int, int, int]) -> Literal["air", "rock"] | None:
    """Return what a box of a level's lattice points is, if that can be shown. first, shape: as in `_sample`."""
    flat = flatten(recipe, lod)
    planes, rows, width = shape
    (x, y, z), step = first, 1 << lod
    top = y + step * (planes - 1)
    if y >= flat.sky:
        return "air"
    if top <= flat.ground:
        return "rock"
    found = bounds_of_box(flat.kept, first, (x + step * (width - 1), top, z + step * (rows - 1)))
    if found.failed[0] != ALL_FINITE:  # what is finite all over the world may have wider bounds in a part of it
        return None
    if found.low[flat.kept.result, 0] >= 0:
        return "air"
    return "rock" if found.high[flat.kept.result, 0] < 0 else None


def _coarse_box(key: ChunkKey, shape: ChunkShape, coarser: int) -> tuple[Place, tuple[int, int, int]]:
    """Return which lattice points of the next level a mask takes: the first (x, y, z), voxels; how many, (y, z, x)."""
    box = coarse_box(shape.cells, coarser)
    x, y, z = (at + 2 * key.step * by for at, by in zip(key.low_corner(shape.cells), box.low, strict=True))
    return (x, y, z), box.shape


def _first(key: ChunkKey, shape: ChunkShape) -> Place:
    """Return the coordinates x, y, z of the first sample, voxels. Raises `BadKey` or `BadParameter`."""
    check_shape(shape)
    check_key(key, shape.cells)
    x, y, z = key.low_corner(shape.cells)
    margin = shape.apron * key.step
    return x - margin, y - margin, z - margin
