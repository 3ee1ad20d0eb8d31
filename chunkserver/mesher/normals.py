"""Normals from the field, never from faces: central differences at the two corners of a crossed edge.

The gradient at each corner is interpolated with the vertex's own t and normalised; it points into the air, since
density grows that way. Both chunks at a border work this out from the same samples, so their normals agree to the bit.
All in float64; differences of float32 samples are exact or rounded once, alike everywhere.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined

INT8_SCALE: Final = 127.0


@inlined
def gradient(density: NDArray[np.float32], y: int, z: int, x: int) -> tuple[float, float, float]:
    """Return twice the density's gradient (x, y, z) per cell at sample (y, z, x), by central differences."""
    return (
        np.float64(density[y, z, x + 1]) - np.float64(density[y, z, x - 1]),
        np.float64(density[y + 1, z, x]) - np.float64(density[y - 1, z, x]),
        np.float64(density[y, z + 1, x]) - np.float64(density[y, z - 1, x]),
    )


@inlined
def edge_normal(
    density: NDArray[np.float32], y: int, z: int, x: int, axis: int, t: float
) -> tuple[float, float, float]:
    """Return the unit normal at `t` along the crossed edge from sample (y, z, x) one cell along `axis`.

    Where the interpolated gradient is zero, it is the edge's direction towards its air corner.
    """
    y1, z1, x1 = y + (axis == 1), z + (axis == 2), x + (axis == 0)
    ax, ay, az = gradient(density, y, z, x)
    bx, by, bz = gradient(density, y1, z1, x1)
    nx, ny, nz = ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)
    square = nx * nx + ny * ny + nz * nz
    if square == 0.0:
        towards_air = 1.0 if density[y1, z1, x1] > density[y, z, x] else -1.0
        return towards_air * (axis == 0), towards_air * (axis == 1), towards_air * (axis == 2)
    length = np.sqrt(square)
    return nx / length, ny / length, nz / length


@inlined
def store_normal(
    normal: tuple[float, float, float], vertex: int, as_int8: NDArray[np.int8], as_float32: NDArray[np.float32]
) -> None:
    """Write a unit normal into whichever of the two arrays has rows, in that array's type."""
    for axis in range(3):
        if as_int8.shape[0] > 0:
            as_int8[vertex, axis] = np.int8(np.floor(normal[axis] * INT8_SCALE + 0.5))
        else:
            as_float32[vertex, axis] = np.float32(normal[axis])
    if as_int8.shape[0] > 0:
        as_int8[vertex, 3] = 0
