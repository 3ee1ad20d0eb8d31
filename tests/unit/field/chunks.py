"""What the field's tests sample: a chunk of a recipe, and where its samples lie."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, canonical

SEED = 7
SHAPE = ChunkShape(16)
KEY = ChunkKey(0, -1, 0, 1)

Floats = NDArray[np.float32]
Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def recipe(tree: object, seed: int = SEED) -> WorldRecipe:
    return WorldRecipe(seed, canonical(tree))


def density(tree: object, key: ChunkKey = KEY, shape: ChunkShape = SHAPE) -> Floats:
    """Return the samples of a chunk, axes (y, z, x)."""
    return sample(recipe(tree), key, shape).density


def lattice(key: ChunkKey = KEY, shape: ChunkShape = SHAPE) -> Axes:
    """Return x, y, z of a chunk's samples, each in the samples' own shape (y, z, x)."""
    low = key.low_corner(shape.cells)
    along = [np.float64(low[axis]) + key.step * (np.arange(shape.samples) - shape.apron) for axis in range(3)]
    y, z, x = np.meshgrid(along[1], along[2], along[0], indexing="ij")
    return x, y, z
