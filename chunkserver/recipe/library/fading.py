"""How the built-in worlds keep what is thin from falling to pieces at coarse levels."""

import math

from chunkserver.recipe.builder import detail
from chunkserver.recipe.node import Node


def at_once(a: Node, size: float, share: float = 1.0) -> Node:
    """Return features of `size` voxels taken for a power of two: for the share of them that is thick enough, or less.

    Steps double from level to level, so such a feature is either 8 of them or more, whole, or at most 4, gone: at no
    level is it half faded, thinner than a cell in places and in pieces there.
    """
    mantissa, _ = math.frexp(share * size)
    return detail(a, factor=0.5 * share / mantissa)
