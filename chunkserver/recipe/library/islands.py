"""Islands: a flat sea floor, and land that rises from it over beaches on one side and cliffs on the other."""

from typing import Final

from chunkserver.recipe.builder import fbm2, heightfield, remap, select, simplex2, warp
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

ISLANDS_RELIEF: Final = 90.0
SEA_FLOOR: Final = -10.0
"""Where the land ends, voxels: the water's surface would be at y = 0."""
BEACH: Final = ((0.0, SEA_FLOOR), (0.06, -1.0), (0.13, 3.0), (0.22, 10.0))
CLIFF: Final = ((0.03, SEA_FLOOR), (0.09, -4.0), (0.14, 16.0), (0.18, 22.0))
"""Height over the land's noise, up to where the hills begin."""
PEAK: Final = 0.6
"""Noise of the highest peaks: more is rare."""


def islands(relief: Size = ISLANDS_RELIEF) -> Node:
    """An archipelago above a flat sea floor: beaches, cliffs, hills."""
    bend = [fbm2(frequency=0.006, octaves=3, salt=salt) * 40 for salt in (1, 2)]
    land = warp(fbm2(frequency=0.004, octaves=6, gain=0.45), x=bend[0], z=bend[1])
    beach, cliff = (remap(land, points=(*coast, (PEAK, relief))) for coast in (BEACH, CLIFF))
    return heightfield(select(simplex2(frequency=0.005, salt=3), below=beach, above=cliff, width=0.4))
