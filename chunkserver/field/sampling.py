"""From a recipe and a chunk key to the samples of that chunk, apron included; or to the proof that none are needed."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.flatten import flatten
from chunkserver.field.interpreter import SLAB_POINTS, run
from chunkserver.field.intervals import ALL_FINITE, bounds
from chunkserver.field.noise.lattice import scratch
from chunkserver.grid import ChunkKey, ChunkShape, check_key, check_shape
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples


def sample(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape) -> Samples:
    """Return the densities of chunk `key`, band-limited to its level, every sample worked out anew.

    Each sample depends on its lattice point, the recipe and the level alone, so chunks that share a point agree to the
    bit (`tests/property/test_field_neighbours.py`).

    Raises `BadKey` for a key outside the world, `BadParameter` for a shape that is not built, `BadRecipe` for a recipe
    that passes a limit or is not finite all over the world. An empty chunk is no error.
    """
    low = _low(key, shape)
    tape = flatten(recipe, key.lod).tape
    side = shape.samples
    slabs = -(-side * side // SLAB_POINTS)
    slab = -(-side * side // slabs)
    density = np.empty((side, side * side), np.float32)
    places, values = np.empty((tape.places, slab)), np.empty((tape.values, slab), np.float32)
    run(
        tape.code,
        tape.numbers,
        tape.keys,
        tape.columns,
        tape.result,
        low,
        float(key.step),
        side,
        places,
        values,
        *scratch(),
        density,
    )
    return Samples(shape, density.reshape(side, side, side))


def prove(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape) -> Literal["air", "rock"] | None:
    """Return what all samples of chunk `key` are, apron included, if bounds of the field show it; None if they do not.

    Takes microseconds, where sampling takes hundreds. Raises what `sample` raises.
    """
    low = _low(key, shape)
    tape = flatten(recipe, key.lod).kept
    failed, values = bounds(tape, np.stack([low, low + key.step * (shape.samples - 1)], 1))
    lowest, highest = values[tape.result]
    if failed != ALL_FINITE:  # what is finite all over the world may have wider bounds in a part of it, by a rounding
        return None
    if lowest >= 0:
        return "air"
    return "rock" if highest < 0 else None


def _low(key: ChunkKey, shape: ChunkShape) -> NDArray[np.float64]:
    """Return the coordinates x, y, z of the first sample, voxels. Raises `BadKey` or `BadParameter`."""
    check_shape(shape)
    check_key(key, shape.cells)
    return np.array(key.low_corner(shape.cells), np.float64) - shape.apron * key.step
