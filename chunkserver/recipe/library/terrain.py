"""The article's field: rolling hills with caves cut out; and each of the two alone."""

from typing import Final

from chunkserver.recipe.builder import fbm2, maximum, simplex3, y
from chunkserver.recipe.node import Node, Number

RELIEF_VOXELS: Final = 24.0
CAVE_FREQUENCY: Final = 0.05
CAVE_THRESHOLD: Final = 0.6
CAVE_SCALE: Final = 6.0
"""Makes the gradient of the cave term about 1 per voxel at its surface (measured: `tests/unit/field/test_noise.py`),
without moving that surface, so that an edit's strength means voxels."""


def terrain(relief: Number = RELIEF_VOXELS) -> Node:
    """Rolling hills with caves cut out: the article's field."""
    return maximum(hills(relief), caves())


def hills(relief: Number = RELIEF_VOXELS) -> Node:
    """A heightfield of octaves of gradient noise, `relief` voxels high."""
    return y - fbm2(frequency=0.02, octaves=5) * relief


def caves() -> Node:
    """Rock with caves where simplex noise passes a threshold."""
    return (simplex3(frequency=CAVE_FREQUENCY) - CAVE_THRESHOLD) * CAVE_SCALE
