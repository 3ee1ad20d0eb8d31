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

_Vector = tuple[float, float, float]
_Index = int | np.uint64


@inlined
def gradient(density: NDArray[np.float32], at: _Index, row: _Index, plane: _Index) -> tuple[float, float, float]:
    """Return twice the density's gradient (x, y, z) per cell at the flat index `at`, by central differences.

    density: flat, axes (y, z, x). row, plane: how far apart neighbours in z and in y are.
    """
    return (
        np.float64(density[at + 1]) - np.float64(density[at - 1]),
        np.float64(density[at + plane]) - np.float64(density[at - plane]),
        np.float64(density[at + row]) - np.float64(density[at - row]),
    )


@inlined
def edge_gradient(
    density: NDArray[np.float32], low: _Index, high: _Index, row: _Index, plane: _Index, t: float
) -> tuple[float, float, float]:
    """Return twice the gradient per cell at `t` along the edge from the flat index `low` to `high`. Others as above."""
    return between(gradient(density, low, row, plane), gradient(density, high, row, plane), t)


@inlined
def between(a: _Vector, b: _Vector, t: float) -> _Vector:
    """Return what is at `t` on the way from one vector to another."""
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])


@inlined
def unit(vector: _Vector) -> tuple[float, float, float, float]:
    """Return a vector's direction, of length 1, and the square of its length: if that is 0, so is the direction."""
    x, y, z = vector
    square = x * x + y * y + z * z
    length = np.sqrt(square) if square > 0.0 else 1.0
    return x / length, y / length, z / length, square


@inlined
def edge_normal(
    density: NDArray[np.float32], low: _Index, high: _Index, row: _Index, plane: _Index, t: float
) -> tuple[float, float, float]:
    """Return the unit normal at `t` along the crossed edge from the flat index `low` to `high`. Others as `gradient`.

    Where the interpolated gradient is zero, it is the edge's direction towards its air corner.
    """
    nx, ny, nz, square = unit(edge_gradient(density, low, high, row, plane, t))
    if square == 0.0:
        towards_air = 1.0 if density[high] > density[low] else -1.0
        along = high - low
        return towards_air * (along == 1), towards_air * (along == plane), towards_air * (along == row)
    return nx, ny, nz


@inlined
def twin_normal(
    fine: NDArray[np.float32],
    at: int,
    row: int,
    plane: int,
    coarse: NDArray[np.float32],
    coarse_at: int,
    coarse_row: int,
    coarse_plane: int,
) -> tuple[float, float, float]:
    """Return the unit normal between a fine corner and its coarse twin: of the sum of both gradients, per voxel.

    Where they cancel it is up: that depends on nothing but the place, so that all chunks that share it agree.
    """
    ax, ay, az = gradient(fine, at, row, plane)
    bx, by, bz = gradient(coarse, coarse_at, coarse_row, coarse_plane)
    nx, ny, nz, square = unit((2.0 * ax + bx, 2.0 * ay + by, 2.0 * az + bz))
    return (nx, ny, nz) if square > 0.0 else (0.0, 1.0, 0.0)


@inlined
def as_byte(part: float) -> np.int32:
    """Return a component of a unit normal in units of 1 / 127, rounded half up."""
    return np.int32(np.floor(part * INT8_SCALE + 0.5))


@inlined
def store_normal(
    normal: tuple[float, float, float], vertex: int, as_int8: NDArray[np.int8], as_float32: NDArray[np.float32]
) -> None:
    """Write a unit normal into whichever of the two arrays has rows, in that array's type."""
    if as_int8.shape[0] > 0:
        for axis in range(3):
            as_int8[vertex, axis] = np.int8(as_byte(normal[axis]))
        as_int8[vertex, 3] = 0
    else:
        for axis in range(3):
            as_float32[vertex, axis] = np.float32(normal[axis])
