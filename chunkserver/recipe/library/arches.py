"""Alien arches: rings of rock half sunk into dunes, in three directions and sizes, melted into the ground."""

from typing import Final, NamedTuple

from chunkserver.recipe.builder import clamp, fbm3, random, repeat, ridged2, rotate, smooth_min, torus, warp, y
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node


class Family(NamedTuple):
    """Rings of one kind: how they are turned, the width of their cells and their own radius, in radii of an arch."""

    turn: tuple[float, float, float, float]
    cell: float
    size: float


ARCH_RADIUS: Final = 56.0
TUBE: Final = 0.2
FAMILIES: Final = (
    Family((1.0, 0.0, 0.0, 1.0), 4.6, 1.0),
    Family((0.6, 0.6, -0.3, 0.9), 5.9, 1.35),
    Family((0.9, -0.3, 0.5, 0.5), 3.9, 0.6),
)
SLENDER: Final = 0.08
"""How much thinner a ring is for each voxel that it stands higher."""
MELT: Final = 24.0
"""Voxels over which rings melt into the ground. That makes rock of air up to a quarter of it deep, so rings are as much
fatter, and moved away as much again: what levels of detail leave of a ring is then still air."""


def arches(radius: Size = ARCH_RADIUS) -> Node:
    """Rings of rock that rise out of dunes and sink into them again."""
    world = y - ridged2(frequency=0.006, octaves=3, gain=0.35) * 14
    bend = [fbm3(frequency=0.012, octaves=2, salt=salt) * 14 for salt in (1, 2, 3)]
    for number, family in enumerate(FAMILIES):
        rings = warp(_rings(family, radius, number), x=bend[0], y=bend[1], z=bend[2])
        world = smooth_min(world, rings, radius=MELT)
    return world


def _rings(family: Family, radius: float, number: int) -> Node:
    own = family.size * radius
    tube = TUBE * own + MELT / 4
    ring = rotate(at_once(torus(radius=own, tube=tube), 2 * tube) + MELT / 4, quaternion=family.turn)
    x, up, z = (random(salt=4 * number + axis) * own for axis in range(3))
    moved = warp(ring, x=x * 0.25, y=up * 0.4, z=z * 0.25) + clamp(y, low=0.0, high=own) * SLENDER
    return repeat(moved, period=(family.cell * radius, 0.0, family.cell * radius), mean=own)
