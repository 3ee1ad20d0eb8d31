"""The two simplest worlds: a ball and a floor."""

from typing import Final

from chunkserver.recipe import builder
from chunkserver.recipe.node import Length, Node

SPHERE_RADIUS: Final = 48.0


def sphere(radius: Length = SPHERE_RADIUS) -> Node:
    """A ball of rock at the origin."""
    return builder.sphere(radius=radius)


def plane() -> Node:
    """Rock below y = 0."""
    return builder.y
