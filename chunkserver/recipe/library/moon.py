"""A moon: a ball with craters of many sizes; each size is a lattice of balls, some of which the surface cuts."""

from typing import Final, NamedTuple

from chunkserver.recipe.builder import detail, fbm3, random, remap, repeat, rotate, sphere, warp
from chunkserver.recipe.library.parameters import LargeSize
from chunkserver.recipe.node import Node


class Craters(NamedTuple):
    """Craters of one size, the radius of the largest in radii of the moon, and how their lattice is turned."""

    size: float
    turn: tuple[float, float, float, float]


MOON_RADIUS: Final = 400.0
CRATERS: Final = (
    Craters(0.36, (0.1, 0.4, 0.2, 0.9)),
    Craters(0.24, (0.5, -0.2, 0.1, 0.8)),
    Craters(0.17, (-0.3, 0.3, 0.6, 0.7)),
    Craters(0.12, (0.4, 0.6, -0.2, 0.6)),
    Craters(0.085, (0.2, -0.6, 0.5, 0.4)),
    Craters(0.06, (0.7, 0.1, -0.3, 0.5)),
    Craters(0.04, (-0.1, -0.5, 0.2, 0.7)),
    Craters(0.027, (0.3, 0.2, 0.8, 0.1)),
)
CELL: Final = 3.0
STRAY: Final = 0.1
SMALLER: Final = 0.55
"""In radii of a crater: the width of a cell of the lattice, how far from its middle a ball is at most, and by how much
it is smaller at most."""
PROFILE: Final = ((-1.0, 0.24), (-0.45, 0.2), (-0.07, -0.05), (0.0, -0.08), (0.07, -0.055), (0.35, 0.0))
"""How deep the ground is at a distance from the rim, both in radii of the crater. Negative: the wall around it."""


def moon(radius: LargeSize = MOON_RADIUS) -> Node:
    """A ball with craters of many sizes."""
    world = sphere(radius=radius) - fbm3(frequency=5 / radius, octaves=4) * (0.016 * radius)
    for number, craters in enumerate(CRATERS):
        world = world + rotate(_depth(craters.size * radius, number), quaternion=craters.turn)
    return world


def _depth(radius: float, number: int) -> Node:
    """Return how deep craters of this radius are: a ball in each cell, somewhere, of some size.

    `detail` makes the balls fade with the cells, which are larger.
    """
    x, up, z = (random(salt=4 * number + axis) * (STRAY * radius) for axis in range(3))
    smaller = (random(salt=4 * number + 3) + 1) * (0.5 * SMALLER * radius)
    rim = warp(detail(sphere(radius=radius), factor=0.5 * CELL), x=x, y=up, z=z) + smaller
    profile = remap(rim, points=tuple((at * radius, depth * radius) for at, depth in PROFILE))
    return repeat(profile, period=(CELL * radius,) * 3, mean=0.0)
