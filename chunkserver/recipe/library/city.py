"""An endless city: a block is a cell of a repetition, and `random` says what stands in it."""

from typing import Final

from chunkserver.recipe.builder import (
    box,
    cylinder,
    maximum,
    minimum,
    random,
    repeat,
    select,
    sphere,
    translate,
    warp,
    y,
)
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

CITY_HEIGHT: Final = 180.0
BLOCK: Final = 88.0
"""From street to street, voxels."""
HALF: Final = 28.0
"""Half the width of a building, voxels."""
STEPS: Final = ((7, 0.35), (5, 0.7), (3, 1.0))
"""A tower's steps: width in bays, odd so that walls stand between pillars; height in shares of the tower."""
BAY: Final = 8.0
STOREY: Final = 10.0
PILLAR: Final = 2.0
"""Width of a window and its pillar, height of a storey; half the width of a pillar, and how far it stands out."""


def city(height: Size = CITY_HEIGHT) -> Node:
    """Streets without end between towers, halls and domes; `height` is that of the highest."""
    return minimum(y, repeat(_block(height), period=(BLOCK, 0.0, BLOCK), mean=HALF))


def _block(height: float) -> Node:
    """Return one block: a pavement and a building of some kind."""
    own = (random(salt=1) + 1) * 0.5
    seen = (own * own * 0.85 + 0.15) * height
    kinds = select(random(salt=2), below=_dome(), above=_hall(), at=0.0)
    building = select(random(salt=3), below=kinds, above=_tower(height, seen), at=-0.45)
    return minimum(box(half_extents=(HALF + 6, 3.0, HALF + 6)), building)


def _tower(height: float, seen: Node) -> Node:
    """Return a tower in steps, each standing so deep in the ground that its share of what is seen is seen."""
    return minimum(*(warp(_walls(bays * BAY / 2, height), y=height - seen * share) for bays, share in STEPS))


def _walls(half: float, height: float) -> Node:
    """Return a box with windows: a smaller one behind a grid of pillars."""
    behind = box(half_extents=(half - PILLAR, height, half - PILLAR))
    lines = [
        repeat(
            box(half_extents=tuple(PILLAR if i == axis else 4 * height for i in range(3))), period=period, mean=PILLAR
        )
        for axis, period in ((0, (BAY, 0.0, 0.0)), (1, (0.0, STOREY, 0.0)), (2, (0.0, 0.0, BAY)))
    ]
    return minimum(behind, maximum(box(half_extents=(half, height, half)), minimum(*lines)))


def _dome() -> Node:
    return minimum(cylinder(radius=HALF, half_height=14.0), translate(sphere(radius=HALF - 3), offset=(0.0, 14.0, 0.0)))


def _hall() -> Node:
    """Return a round hall without a roof."""
    return maximum(cylinder(radius=HALF, half_height=36.0), 16.0 - cylinder(radius=1.0, half_height=100.0))
