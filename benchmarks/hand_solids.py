"""Fifty nodes of solids, without noise: as a recipe, and as one function written by hand. The same bits of both.

Five figures, each a rounded box cut by a sphere, with a ring, a smooth arm and a post, moved as a whole.
"""

import functools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import ChunkKey
from chunkserver.kernel import inlined, kernel
from chunkserver.recipe.builder import box, capsule, cylinder, maximum, minimum, smooth_min, sphere, torus, translate
from chunkserver.recipe.node import Node

FIGURES: Final = (
    (0.0, 0.0, 0.0, 20.0),
    (-30.0, 10.0, 25.0, 10.0),
    (35.0, -15.0, 10.0, 20.0),
    (-15.0, -30.0, -30.0, 10.0),
    (20.0, 25.0, -35.0, 20.0),
)
"""Of each: x, y, z of its middle and its size, voxels. Whole numbers, so that differences of them are exact."""
OFFSET: Final = (1.5, -2.25, 0.75)
SMOOTH: Final = 4.0
SIDE: Final = 35
ROW: Final = 36
"""SIDE, padded to vectors of four."""

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]


def recipe() -> Node:
    """Return the fifty nodes: five figures of nine, four that join them, and the move."""
    return translate(functools.reduce(minimum, [_node(*figure) for figure in FIGURES]), offset=OFFSET)


def _node(x: float, y: float, z: float, size: float) -> Node:
    center = x, y, z
    half = size, 0.6 * size, 0.8 * size
    cut = maximum(box(center=center, half_extents=half, rounding=0.1 * size), sphere(center=center, radius=1.1 * size))
    ringed = minimum(cut, torus(center=center, radius=1.3 * size, tube=0.2 * size))
    arm = capsule(a=center, b=(x + size, y + 2 * size, z + size / 2), radius=0.3 * size)
    post = cylinder(center=center, radius=0.4 * size, half_height=1.5 * size)
    return minimum(smooth_min(ringed, arm, radius=SMOOTH), post)


def solids(key: ChunkKey) -> _Floats:
    """Return the field of chunk `key` (LOD 0, 32 cells): density (35, 35, 35) float32, as `Samples` has it."""
    low = np.array(key.low_corner(SIDE - 3), np.float64) - 1.0
    density = np.empty(SIDE**3 + ROW - SIDE, np.float32)
    _fill(low, density)
    return density[: SIDE**3].reshape(SIDE, SIDE, SIDE)


def _constants(x: float, y: float, z: float, size: float) -> tuple[float, ...]:
    """Return the numbers of a figure: middle, box, rounding, sphere, ring, tube, arm, its radius, post."""
    rounding, along = 0.1 * size, (size, 2 * size, size / 2)
    extents = size - rounding, 0.6 * size - rounding, 0.8 * size - rounding
    square = math.fsum(step * step for step in along)
    radii = 1.1 * size, 1.3 * size, 0.2 * size
    return (x, y, z, *extents, rounding, *radii, *along, 1 / square, 0.3 * size, 0.4 * size, 1.5 * size)


_ONE, _TWO, _THREE, _FOUR, _FIVE = (_constants(*figure) for figure in FIGURES)
_RADIUS, _SHARE, _LIMIT = np.float32(SMOOTH), np.float32(0.25 / SMOOTH), np.float32(65536)


@kernel
def _fill(low: _Doubles, density: _Floats) -> None:
    """Write the chunk whose first sample is at `low`. What is written beyond the end of a row, the next overwrites."""
    for y in range(SIDE):
        for z in range(SIDE):
            start = (y * SIDE + z) * SIDE
            _fill_row(low[0], low[1] + y - OFFSET[1], low[2] + z - OFFSET[2], density[start : start + ROW])


@inlined
def _fill_row(low: float, y: float, z: float, row: _Floats) -> None:
    for i in range(ROW):
        x = low + i - OFFSET[0]
        value: Any = _figure(x, y, z, _ONE)
        for other in (_figure(x, y, z, _TWO), _figure(x, y, z, _THREE), _figure(x, y, z, _FOUR)):
            value = _less(value, other)
        row[i] = _greater(_less(_less(value, _figure(x, y, z, _FIVE)), _LIMIT), -_LIMIT)


@inlined
def _figure(x: float, y: float, z: float, p: tuple[float, ...]) -> Any:
    dx, dy, dz = x - p[0], y - p[1], z - p[2]
    qx, qy, qz = abs(dx) - p[3], abs(dy) - p[4], abs(dz) - p[5]
    inside = _greater(_greater(qx, qy), qz)
    outside = _length(_greater(qx, 0.0), _greater(qy, 0.0), _greater(qz, 0.0))
    of_box = np.float32(outside + (inside if inside < 0.0 else 0.0) - p[6])
    cut = _greater(of_box, np.float32(_length(dx, dy, dz) - p[7]))
    across = np.sqrt(dx * dx + dz * dz)
    ring = across - p[8]
    ringed = _less(cut, np.float32(np.sqrt(ring * ring + dy * dy) - p[9]))
    t = _less(_greater((dx * p[10] + dy * p[11] + dz * p[12]) * p[13], 0.0), 1.0)
    arm = np.float32(_length(dx - t * p[10], dy - t * p[11], dz - t * p[12]) - p[14])
    near = _greater(np.float32(_RADIUS - abs(np.float32(ringed - arm))), np.float32(0))
    joined = np.float32(_less(ringed, arm) - np.float32(np.float32(near * near) * _SHARE))
    side, end = across - p[15], abs(dy) - p[16]
    corner, deep = _length(_greater(side, 0.0), _greater(end, 0.0), 0.0), _greater(side, end)
    return _less(joined, np.float32(corner + (deep if deep < 0.0 else 0.0)))


@inlined
def _length(x: float, y: float, z: float) -> Any:
    return np.sqrt(x * x + y * y + z * z)


@inlined
def _less(a: Any, b: Any) -> Any:
    return a if a < b else b


@inlined
def _greater(a: Any, b: Any) -> Any:
    return a if a > b else b
