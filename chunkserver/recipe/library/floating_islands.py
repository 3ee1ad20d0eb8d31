"""Floating islands: cells of a repetition hold one each; noise of the whole world makes their rock rough."""

from typing import Final

from chunkserver.recipe.builder import cylinder, fbm2, fbm3, random, remap, repeat, smooth_max, warp, y
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

FLOATING_RADIUS: Final = 80.0
"""Of the largest."""
CELL: Final = 3.4
STRAY: Final = 0.35
"""In radii: the width of a cell, and how far from its middle an island is at most."""
SMALLER: Final = 0.5
"""By how much an island's radius is smaller at most, in radii."""
TAPER: Final = ((-1.5, 1.5), (-0.7, 0.62), (-0.32, 0.32), (-0.2, 0.05), (0.0, 0.0))
"""How much narrower an island is at a height below its meadow, both in radii."""


def floating_islands(radius: Size = FLOATING_RADIUS) -> Node:
    """Islands in the sky: meadows on top, roots of rock below."""
    hills = fbm2(frequency=1.0 / radius, octaves=4) * (0.07 * radius)
    crags = fbm3(frequency=1.2 / radius, octaves=3, gain=0.4) * (0.2 * radius)
    return smooth_max(_somewhere(y, radius) - hills, _somewhere(_root(radius), radius) + crags, radius=0.08 * radius)


def _somewhere(a: Node, radius: float) -> Node:
    """Return one of it in each cell, in a random place."""
    far = [random(salt=axis) * (STRAY * radius) for axis in range(3)]
    return repeat(warp(a, x=far[0], y=far[1], z=far[2]), period=(CELL * radius,) * 3, mean=radius)


def _root(radius: float) -> Node:
    """Return a cone that hangs down, its sides hollow."""
    sides = at_once(cylinder(radius=radius, half_height=8 * radius), 2 * radius, share=0.5)
    taper = remap(y, points=tuple((at * radius, by * radius) for at, by in TAPER))
    return sides + taper + (random(salt=3) + 1) * (0.5 * SMALLER * radius)
