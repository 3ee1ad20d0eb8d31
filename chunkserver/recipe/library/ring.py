"""A ring world: land on the inside of a wide ring, held in by walls."""

from typing import Final

from chunkserver.recipe.builder import box, clamp, cylinder, fbm3, maximum, minimum
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.parameters import LargeSize
from chunkserver.recipe.node import Node

RING_RADIUS: Final = 640.0
WIDTH: Final = 0.4
SHELL: Final = 0.125
"""The ring's width and its thickness, in radii: it is gone at the level at which its rock would be too thin."""
RELIEF: Final = 40.0
LAKE: Final = -0.05
"""Height of the highest hills, voxels; of the lakes, in shares of it."""
WALL: Final = 30.0
WALL_THICK: Final = 12.0


def ring(radius: LargeSize = RING_RADIUS) -> Node:
    """A ring with hills and lakes on its inside, and walls along its edges."""
    far = 8 * radius
    outwards = cylinder(radius=radius, half_height=far)
    half = WIDTH * radius / 2
    beyond = at_once(box(half_extents=(far, half, far)), WIDTH * radius)
    land = clamp(fbm3(frequency=0.006, octaves=5, gain=0.42), low=LAKE, high=1.0) * RELIEF
    walls = maximum(-outwards - WALL, -beyond - WALL_THICK)
    return maximum(minimum(-outwards - land, walls), outwards - SHELL * radius, beyond)
