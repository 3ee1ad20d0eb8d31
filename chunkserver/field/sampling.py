"""From a recipe and a chunk key to the samples of that chunk, apron included; or to the proof that none are needed."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.flatten import flatten
from chunkserver.field.interpreter import SLAB_POINTS, run
from chunkserver.field.intervals import ALL_FINITE, bounds
from chunkserver.field.noise.lattice import scratch
from chunkserver.field.tape import INPUTS, Tape
from chunkserver.grid import ChunkKey, ChunkShape, check_key, check_shape
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples, coarse_box


def sample(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Samples:
    """Return the densities of chunk `key`, band-limited to its level, every sample worked out anew.

    coarser: mask of the faces whose neighbour is one level coarser: there the next level's field is sampled too.

    Each sample depends on its lattice point, the recipe and the level alone, so chunks that share a point agree to the
    bit (`tests/property/test_field_neighbours.py`).

    Raises `BadKey` for a key outside the world, `BadParameter` for a shape that is not built, `BadRecipe` for a recipe
    that passes a limit or is not finite all over the world. An empty chunk is no error.
    """
    low = _low(key, shape)
    side = shape.samples
    density = _sample(recipe, key.lod, low, (side, side, side))
    if not coarser:
        return Samples(shape, density)
    return Samples(shape, density, coarser, _sample(recipe, key.lod + 1, *_coarse_box(key, shape, coarser)))


def _sample(
    recipe: WorldRecipe, lod: int, low: NDArray[np.float64], shape: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Return a level's densities over a box of its lattice points. low: x, y, z of the first one; shape: (y, z, x)."""
    tape = flatten(recipe, lod).tape
    planes, rows, width = shape
    slabs = -(-rows * width // SLAB_POINTS)
    slab = -(-rows * width // slabs)
    density = np.empty((planes, rows * width), np.float32)
    _run(tape, lod, low, rows, np.empty((tape.places, slab)), density)
    return density.reshape(shape)


def densities(recipe: WorldRecipe, lod: int, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a level's densities at points anywhere in the world.

    points: (n, 3) float64, x y z, voxels.

    Returns (n,) float32, voxels, negative = rock, else air: at a lattice point to the bit what `sample` gives. Raises
    `BadRecipe` as `sample` does.
    """
    tape = flatten(recipe, lod).tape
    density, places, anywhere = np.empty(len(points), np.float32), np.empty((tape.places, SLAB_POINTS)), np.zeros(3)
    for start in range(0, len(points), SLAB_POINTS):
        slab = points[start : start + SLAB_POINTS]
        places[:INPUTS, : len(slab)] = slab.T
        _run(tape, lod, anywhere, 0, places, density[None, start : start + SLAB_POINTS])
    return density


def _run(
    tape: Tape,
    lod: int,
    low: NDArray[np.float64],
    rows: int,
    places: NDArray[np.float64],
    density: NDArray[np.float32],
) -> None:
    """Run a level's tape; low, rows, places and density: as in `run`."""
    values = np.empty((tape.values, places.shape[1]), np.float32)
    code, step = (tape.code, tape.numbers, tape.keys, tape.columns, tape.result), float(1 << lod)
    run(*code, low, step, rows, places, values, *scratch(), density)


def prove(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> Literal["air", "rock"] | None:
    """Return what all samples of chunk `key` are, apron included, if bounds of the field show it; None if they do not.

    coarser: as in `sample`; then the next level's samples are among them.

    Takes microseconds, where sampling takes hundreds. Raises what `sample` raises.
    """
    side = shape.samples
    proven = _prove(recipe, key.lod, _low(key, shape), (side, side, side))
    if proven and coarser and _prove(recipe, key.lod + 1, *_coarse_box(key, shape, coarser)) != proven:
        return None
    return proven


def _prove(
    recipe: WorldRecipe, lod: int, low: NDArray[np.float64], shape: tuple[int, int, int]
) -> Literal["air", "rock"] | None:
    """Return what a box of a level's lattice points is, if that can be shown. low, shape: as in `_sample`."""
    tape = flatten(recipe, lod).kept
    planes, rows, width = shape
    far = low + float(1 << lod) * np.array((width - 1, planes - 1, rows - 1))
    failed, values = bounds(tape, np.stack([low, far], 1))
    lowest, highest = values[tape.result]
    if failed != ALL_FINITE:  # what is finite all over the world may have wider bounds in a part of it, by a rounding
        return None
    if lowest >= 0:
        return "air"
    return "rock" if highest < 0 else None


def _coarse_box(key: ChunkKey, shape: ChunkShape, coarser: int) -> tuple[NDArray[np.float64], tuple[int, int, int]]:
    """Return which lattice points of the next level a mask takes: the first (x, y, z), voxels; how many, (y, z, x)."""
    box = coarse_box(shape.cells, coarser)
    return np.array(key.low_corner(shape.cells), np.float64) + 2 * key.step * np.array(box.low), box.shape


def _low(key: ChunkKey, shape: ChunkShape) -> NDArray[np.float64]:
    """Return the coordinates x, y, z of the first sample, voxels. Raises `BadKey` or `BadParameter`."""
    check_shape(shape)
    check_key(key, shape.cells)
    return np.array(key.low_corner(shape.cells), np.float64) - shape.apron * key.step
