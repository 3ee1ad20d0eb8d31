"""A planet: a ball with relief on it and caves in it."""

from typing import Final

from chunkserver.recipe.builder import fbm3, smooth_max, sphere
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.terrain import CAVE_FREQUENCY, RELIEF_VOXELS, caves
from chunkserver.recipe.node import Length, Node, Number

PLANET_RADIUS: Final = 200.0
CUT_RADIUS: Final = 3.5
"""Rounds the edge where a cave meets the ground. A sharp one leaves chips of rock where a cave only grazes it. Caves
that are gone are rock by 3.6 voxels, which is more: they leave no trace."""


def planet(radius: Length = PLANET_RADIUS, relief: Number = RELIEF_VOXELS) -> Node:
    """A ball of rock with relief on its surface and caves inside."""
    surface = sphere(radius=radius) - fbm3(frequency=0.01, octaves=5) * relief
    return smooth_max(surface, at_once(caves(), size=1 / CAVE_FREQUENCY), radius=CUT_RADIUS)
