"""White noise: a number for each cell of the integer lattice, that has nothing to do with those of other cells."""

import numpy as np

from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    HERE,
    ROUND_2,
    Doubles,
    Floats,
    Words,
    axis_hashes,
    nearest,
    stir,
    unit,
)
from chunkserver.kernel import inlined, kernel


@kernel
def white(x: Doubles, y: Doubles, z: Doubles, keys: Words, out: Floats) -> None:
    """Write a number in [-1, 1], evenly spread, mean 0, for each cell: whole x, y, z (n,) within COORDINATE_MAX."""
    for i in range(out.size):
        total = _axis(x[i], AXIS_X, keys[0]) + _axis(y[i], AXIS_Y, keys[1]) + _axis(z[i], AXIS_Z, keys[2])
        out[i] = unit(stir(stir(np.uint32(total), ROUND_2), ROUND_2))


@inlined
def _axis(coordinate: float, axis: np.uint32, key: np.uint32) -> np.uint32:
    bits = nearest(coordinate)[1]
    return axis_hashes(np.uint32(bits), np.uint32(bits >> np.uint64(32)), HERE, axis, key)[0]
