"""Canyons: the distance to the river is worked out once, and every bench of rock begins at a distance of its own."""

import math
from typing import Final

from chunkserver.recipe.builder import fbm2, remap, repeat, ridged2, smooth_max, smooth_min, warp, y
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

CANYON_WIDTH: Final = 60.0
RIVER_FREQUENCY: Final = 0.0022
RIVER_RISE: Final = 2.6
"""How fast the river's noise rises beside it, per lattice cell."""
BED: Final = -76.0
BENCHES: Final = ((-58.0, 0.25), (-34.0, 0.55), (-8.0, 1.05), (34.0, 2.7), (62.0, 3.2))
"""Height of each bench, voxels, and where it begins, in canyon widths from the middle of the river."""
ROUND: Final = 8.0
"""Voxels over which the edges of benches and the feet of walls are rounded. Sharp ones leave crumbs and hollows
where layers stand out."""
LEAN: Final = ((BED, -24.0), (BED + 24, -10.0), (64.0, 12.0))
"""How far walls stand back at a height, voxels: at their foot there is a slope of rubble."""
LAYER: Final = 6.0
SOFT: Final = (0.0, 1.6, 0.3, 2.2)
"""Height of a layer of rock, voxels, and how far each stands back, again and again: harder ones stand out."""


def canyon(width: Size = CANYON_WIDTH) -> Node:
    """River canyons with terraced walls of layered rock, and mesas above them."""
    bend = [fbm2(frequency=0.004, octaves=2, salt=salt) * 70 for salt in (1, 2)]
    river = (1 - warp(ridged2(frequency=RIVER_FREQUENCY, octaves=1), x=bend[0], z=bend[1])) * 0.5
    rough = fbm2(frequency=0.015, octaves=4, salt=3)
    beside = river * (1 / (RIVER_RISE * RIVER_FREQUENCY)) + rough * 24 - _layers() - remap(y, points=LEAN)
    world = y - BED - rough * 5
    for top, begins in BENCHES:
        bench = smooth_max(y - top - rough * 5, begins * width - beside, radius=ROUND)
        world = smooth_min(world, bench, radius=ROUND)
    return world


def _layers() -> Node:
    """Return how far the rock of a height stands back, voxels. Coarse levels have no layers: those would be crumbs."""
    period = LAYER * len(SOFT)
    feet = [(LAYER * number - period / 2, back) for number, back in enumerate(SOFT)]
    points = [(foot + rise, back) for foot, back in feet for rise in (0.0, 0.75 * LAYER)] + [(period / 2, SOFT[0])]
    layers = repeat(remap(y, points=tuple(points)), period=(0.0, period, 0.0), mean=math.fsum(SOFT) / len(SOFT))
    return warp(at_once(layers, period, share=1 / 3), y=fbm2(frequency=0.006, octaves=2, salt=4) * 12)
