"""The one compiled interpreter that runs every tape: a dispatch per instruction, a loop over a plane of points inside.

A plane has n * n points, z slow and x fast, flat: one long loop that vectorises without tails. Coordinate registers are
float64; value registers are float32. Registers of different instructions never overlap.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.noise import add_gradient2, add_simplex3
from chunkserver.kernel import kernel

CONSTANT: Final = 0
X: Final = 1
Y: Final = 2
Z: Final = 3
ADD: Final = 4
SUBTRACT: Final = 5
MULTIPLY: Final = 6
MIN: Final = 7
MAX: Final = 8
SPHERE: Final = 9
GRADIENT2: Final = 10
SIMPLEX3: Final = 11

READS_Y: Final = frozenset({Y, SPHERE, SIMPLEX3})
"""Instructions whose value differs from one horizontal plane to the next, whatever their operands."""

NUMBERS: Final = 5
"""Constants an instruction may have."""

DENSITY_MAX: Final = np.float32(65536)
"""The field is clamped to +-DENSITY_MAX voxels, so that edits add to it without overflow, or to +-CELLS_MAX cells where
that is more: a surface and its normals never depend on a clamped sample. NaN cannot pass: it becomes air."""
CELLS_MAX: Final = np.float32(4)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]


@kernel
def run(
    code: NDArray[np.int32],
    numbers: _Doubles,
    keys: _Words,
    columns: int,
    result: int,
    low: _Doubles,
    step: float,
    points: _Doubles,
    registers: _Floats,
    fractions: _Floats,
    words: _Words,
    density: _Floats,
) -> None:
    """Evaluate a tape over a cube of points.

    low: (3,) coordinates x, y, z of the first point, voxels. step: voxels between points.
    points: (3, n * n) scratch for coordinates. registers: (registers, n * n) scratch. fractions, words: scratch too,
        as `noise.scratch` makes them.
    density: (n, n * n) out, a horizontal plane each, y upwards.
    """
    planes = density.shape[0]
    limit = max(DENSITY_MAX, CELLS_MAX * np.float32(step))
    for z in range(planes):
        for x in range(planes):
            points[0, z * planes + x] = low[0] + step * x
            points[2, z * planes + x] = low[2] + step * z
    for plane in range(planes):
        points[1, :] = low[1] + step * plane
        for at in range(0 if plane == 0 else columns, code.shape[0]):
            op, constants = code[at, 0], numbers[at]
            out, a, b = registers[code[at, 1]], registers[code[at, 2]], registers[code[at, 3]]
            if op == CONSTANT:
                out[:] = np.float32(constants[0])
            elif op <= Z:
                _coordinate(points[op - X], out)
            elif op <= MAX:
                _combine(op, a, b, out)
            elif op == SPHERE:
                _sphere(points[0], points[1], points[2], constants, out)
            elif op == GRADIENT2:
                add_gradient2(points[0], points[1], points[2], constants, keys[at], a, out, fractions, words)
            elif op == SIMPLEX3:
                add_simplex3(points[0], points[1], points[2], constants, keys[at], a, out, fractions, words)
        _clamp(registers[result], limit, density[plane])


@kernel
def _coordinate(axis: _Doubles, out: _Floats) -> None:
    for i in range(out.size):
        out[i] = np.float32(axis[i])


@kernel
def _combine(op: int, a: _Floats, b: _Floats, out: _Floats) -> None:
    if op == ADD:
        for i in range(out.size):
            out[i] = a[i] + b[i]
    elif op == SUBTRACT:
        for i in range(out.size):
            out[i] = a[i] - b[i]
    elif op == MULTIPLY:
        for i in range(out.size):
            out[i] = a[i] * b[i]
    elif op == MIN:
        for i in range(out.size):
            out[i] = a[i] if a[i] < b[i] else b[i]
    else:
        for i in range(out.size):
            out[i] = a[i] if a[i] > b[i] else b[i]


@kernel
def _sphere(x: _Doubles, y: _Doubles, z: _Doubles, numbers: _Doubles, out: _Floats) -> None:
    center_x, center_y, center_z, radius = numbers[0], numbers[1], numbers[2], numbers[3]
    for i in range(out.size):
        dx, dy, dz = x[i] - center_x, y[i] - center_y, z[i] - center_z
        out[i] = np.float32(np.sqrt(dx * dx + dy * dy + dz * dz) - radius)


@kernel
def _clamp(values: _Floats, limit: np.float32, out: _Floats) -> None:
    for i in range(out.size):
        value = values[i] if values[i] > -limit else -limit
        out[i] = value if values[i] < limit else limit
