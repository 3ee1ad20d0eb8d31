"""Spires: cellular noise is the distance to the nearest column of rock, and its value the column's height."""

from typing import Any, Final

from chunkserver.recipe.builder import cellular2, fbm2, fbm3, remap, smooth_max, smooth_min, y
from chunkserver.recipe.library.parameters import Size
from chunkserver.recipe.node import Node

SPIRES_HEIGHT: Final = 130.0
CELL: Final = 84.0
"""Voxels from one column to the next."""
OF_COLUMN: Final[dict[str, Any]] = {"frequency": 1 / CELL, "jitter": 0.6, "salt": 1}
GIRTH: Final = ((0.0, 20.0), (0.06, 15.0), (0.45, 12.5), (0.75, 14.0), (1.0, 11.0))
"""Radius of a column, voxels, at a share of the height."""


def spires(height: Size = SPIRES_HEIGHT) -> Node:
    """Columns of rock, high and narrow, over green hills."""
    distance = cellular2(**OF_COLUMN) * CELL
    top = (cellular2(**OF_COLUMN, returns="value") * 0.4 + 0.6) * height
    girth = remap(y, points=tuple((share * height, radius) for share, radius in GIRTH))
    rough = fbm3(frequency=0.03, octaves=3, salt=2) * 8
    column = smooth_max(distance - girth + rough, y - top + fbm2(frequency=0.05, octaves=2, salt=3) * 6, radius=10.0)
    return smooth_min(y - fbm2(frequency=0.008, octaves=5, salt=4) * 30, column, radius=12.0)
