"""Which bricks meet a box, by their keys; and the slots in which they lie, as kernels want them."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_BITS, NONE, Brick, Holds
from chunkserver.edits.boxes import Box, Place

Key = tuple[int, int, int, int]
"""Of a brick: its level, and x, y, z in bricks of that level."""
_Ints = NDArray[np.int32]


def keys_in(lod: int, box: Box) -> list[Key]:
    """Return the keys of all bricks that meet a box of a level, those that are not there too."""
    xs, ys, zs = (range(low, high + 1) for low, high in zip(*box.cubes(BRICK_BITS), strict=True))
    return [(lod, x, y, z) for y in ys for z in zs for x in xs]


def hold(bricks: Iterable[Brick | None], box: Box) -> tuple[_Ints, Place, Holds]:
    """Return the slots of the bricks that meet a box, in the order of `keys_in`: a grid, and its place in the box.

    They lie there for as long as the last value is kept. Raises `StoreFull` if there is no room for all of them.
    """
    x, y, z = box.low
    held = Holds(None if brick is None else brick.hold() for brick in bricks)
    slots = np.array([NONE if each is None else each.slot for each in held], np.int32)
    return slots.reshape(box.cubes(BRICK_BITS).shape), (-(x % BRICK), -(y % BRICK), -(z % BRICK)), held
