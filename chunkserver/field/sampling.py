"""From a recipe and a chunk key to the samples of that chunk, apron included."""

import numpy as np

from chunkserver.field.interpreter import run
from chunkserver.field.noise import scratch
from chunkserver.field.tape import flatten
from chunkserver.grid import ChunkKey, ChunkShape, check_key, check_shape
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples


def sample(recipe: WorldRecipe, key: ChunkKey, shape: ChunkShape) -> Samples:
    """Return the densities of chunk `key`, band-limited to its level, every sample worked out anew.

    Each sample depends on its lattice point, the recipe and the level alone, so chunks that share a point agree to the
    bit (`tests/property/test_field_neighbours.py`).

    Raises `BadKey` for a key outside the world, `BadParameter` for a shape that is not built, `BadRecipe` for a recipe
    that passes a limit. An empty chunk is no error.
    """
    check_shape(shape)
    check_key(key, shape.cells)
    tape = flatten(recipe, key.lod)
    side = shape.samples
    low = np.array(key.low_corner(shape.cells), np.float64) - shape.apron * key.step
    density = np.empty((side, side * side), np.float32)
    points = np.empty((3, side * side), np.float64)
    registers = np.empty((tape.registers, side * side), np.float32)
    run(
        tape.code,
        tape.numbers,
        tape.keys,
        tape.columns,
        tape.result,
        low,
        float(key.step),
        points,
        registers,
        *scratch(),
        density,
    )
    return Samples(shape, density.reshape(side, side, side))
