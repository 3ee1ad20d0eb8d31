"""Canyons: the distance to the river is worked out once, and every bench of rock begins at a distance of its own."""

from typing import Final

from chunkserver.recipe.builder import fbm2, minimum, remap, ridged2, smooth_max, warp, y
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

CANYON_WIDTH: Final = 60.0
RIVER_FREQUENCY: Final = 0.0022
RIVER_RISE: Final = 2.6
"""How fast the river's noise rises beside it, per lattice cell."""
BED: Final = -76.0
BENCHES: Final = ((-58.0, 0.25), (-34.0, 0.55), (-8.0, 1.05), (34.0, 2.7), (62.0, 3.2))
"""Height of each bench, voxels, and where it begins, in canyon widths from the middle of the river."""
LEAN: Final = 0.2
"""How far walls stand back for each voxel that they rise."""
LAYER: Final = 6.0
LAYERS: Final = 16
SOFT: Final = (0.0, 1.8, 0.3, 2.6)
"""Height of a layer of rock and number of layers; how far each stands back, again and again: harder ones stand out."""


def canyon(width: Size = CANYON_WIDTH) -> Node:
    """River canyons with terraced walls of layered rock, and mesas above them."""
    bend = [fbm2(frequency=0.004, octaves=2, salt=salt) * 70 for salt in (1, 2)]
    river = (1 - warp(ridged2(frequency=RIVER_FREQUENCY, octaves=1), x=bend[0], z=bend[1])) * 0.5
    rough = fbm2(frequency=0.015, octaves=4, salt=3)
    beside = river * (1 / (RIVER_RISE * RIVER_FREQUENCY)) + rough * 24 - _layers() - y * LEAN
    world = y - BED - rough * 5
    for top, begins in BENCHES:
        world = minimum(world, smooth_max(y - top - rough * 5, begins * width - beside, radius=5.0))
    return world


def _layers() -> Node:
    """Return how far the rock of a height stands back, voxels."""
    feet = [(BED + LAYER * number, SOFT[number % len(SOFT)]) for number in range(LAYERS)]
    points = [(foot + rise, back) for foot, back in feet for rise in (0.0, 0.75 * LAYER)]
    return remap(y + fbm2(frequency=0.006, octaves=2, salt=4) * 12, points=tuple(points))
