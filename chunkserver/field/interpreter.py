"""The one compiled interpreter that runs every tape: a dispatch per instruction, a loop over a slab of points inside.

A slab is a part of a horizontal plane, SLAB_POINTS at most, whose registers stay in the first or second level of cache.
What does not depend on y is worked out once for a slab, the rest for the same slab of each plane above it:

    for each slab of columns          x, z
        the leading instructions      what does not depend on y
        for each plane                y
            the other instructions
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.arithmetic import combine
from chunkserver.field.coordinates import move
from chunkserver.field.noise.cellular import add_cellular2, add_cellular3
from chunkserver.field.noise.gradient import add_gradient2, add_gradient3
from chunkserver.field.noise.simplex import add_simplex2, add_simplex3
from chunkserver.field.noise.value import add_value2, add_value3
from chunkserver.field.noise.white import white
from chunkserver.field.shapes import distances
from chunkserver.kernel import kernel, spliced

SLAB_POINTS: Final = 1280
"""5 KB a value register, 10 KB a coordinate register. A plane of 32 cells, apron included, is one slab."""

DENSITY_MAX: Final = np.float32(65536)
"""The field is clamped to +-DENSITY_MAX voxels, so that edits add to it without overflow, or to +-CELLS_MAX cells where
that is more: a surface and its normals depend on no clamped sample, unless the density changes by more than 16,384 in a
voxel."""
CELLS_MAX: Final = np.float32(4)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]
_Code = NDArray[np.int32]


@kernel
def run(
    code: _Code,
    numbers: _Doubles,
    keys: _Words,
    columns: int,
    result: int,
    low: _Doubles,
    step: float,
    rows: int,
    places: _Doubles,
    values: _Floats,
    fractions: _Floats,
    words: _Words,
    density: _Floats,
) -> None:
    """Evaluate a tape over a box of points, or over one slab of any points.

    columns: how many leading instructions do not depend on y. result: the value register that holds the density.
    low: (3,) coordinates x, y, z of the first point, voxels. step: voxels between points. rows: points along z; 0 if
        the points are those whose coordinates are in the first three places already: there is one plane of them then.
    places: (coordinate registers, slab) and values: (value registers, slab) scratch; `slab` is how many points are done
        at a time. fractions, words: scratch too, as `noise.lattice.scratch` makes them.
    density: (planes, rows * points along x) out, a horizontal plane each, y upwards, z slow and x fast.
    """
    limit = max(DENSITY_MAX, CELLS_MAX * np.float32(step))
    width = density.shape[1] // max(rows, 1)
    for start in range(0, density.shape[1], places.shape[1]):
        n = min(places.shape[1], density.shape[1] - start)
        if rows:
            _columns(start, width, low, step, places[0, :n], places[2, :n])
        for plane in range(density.shape[0]):
            if rows:
                places[1, :n] = low[1] + step * plane
            for at in range(0 if plane == 0 else columns, code.shape[0]):
                _execute(code[at], numbers, keys[at], n, places, values, fractions, words)
            _clamp(values[result, :n], limit, density[plane, start : start + n])


@kernel
def _columns(start: int, width: int, low: _Doubles, step: float, x: _Doubles, z: _Doubles) -> None:
    """Write the coordinates of a slab that begins `start` points into its plane."""
    row, place = start // width, start % width
    for i in range(x.size):
        x[i], z[i] = low[0] + step * place, low[2] + step * row
        place += 1
        if place == width:
            row, place = row + 1, 0


@spliced
def _execute(
    row: NDArray[np.int32],
    numbers: _Doubles,
    keys: _Words,
    n: int,
    places: _Doubles,
    values: _Floats,
    fractions: _Floats,
    words: _Words,
) -> None:
    op, constants = row[ops.CODE], numbers[row[ops.NUMBERS] :]
    x, y, z = places[row[ops.X], :n], places[row[ops.Y], :n], places[row[ops.Z], :n]
    a, b = values[row[ops.A], :n], values[row[ops.B], :n]
    if op <= ops.COORDINATE_LAST:
        move(op, x, y, z, a, constants, places[row[ops.OUT], :n])
    elif op <= ops.ARITHMETIC_LAST:
        combine(op, a, b, values[row[ops.C], :n], x, constants, values[row[ops.OUT], :n])
    elif op <= ops.SHAPE_LAST:
        distances(op, x, y, z, constants, values[row[ops.OUT], :n])
    else:
        _noise(op, x, y, z, constants, keys, b, values[row[ops.OUT], :n], fractions, words)


@spliced
def _noise(
    op: int,
    x: _Doubles,
    y: _Doubles,
    z: _Doubles,
    numbers: _Doubles,
    keys: _Words,
    below: _Floats,
    out: _Floats,
    fractions: _Floats,
    words: _Words,
) -> None:
    """Write below + amplitude * noise, or for `random` the numbers of cells x, y, z: arrays (n,)."""
    if op == ops.RANDOM:
        white(x, y, z, keys, out)
    elif op == ops.GRADIENT2:
        add_gradient2(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.GRADIENT3:
        add_gradient3(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.VALUE2:
        add_value2(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.VALUE3:
        add_value3(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.SIMPLEX2:
        add_simplex2(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.SIMPLEX3:
        add_simplex3(x, y, z, numbers, keys, below, out, fractions, words)
    elif op == ops.CELLULAR2:
        add_cellular2(x, y, z, numbers, keys, below, out, fractions, words)
    else:
        add_cellular3(x, y, z, numbers, keys, below, out, fractions, words)


@kernel
def _clamp(values: _Floats, limit: np.float32, out: _Floats) -> None:
    for i in range(out.size):
        value = values[i] if values[i] > -limit else -limit
        out[i] = value if values[i] < limit else limit
