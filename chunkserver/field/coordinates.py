"""Moving the point: loops over coordinate registers, all in float64."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.noise.lattice import nearest
from chunkserver.kernel import inlined, kernel

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]


@kernel
def move(op: int, x: _Doubles, y: _Doubles, z: _Doubles, a: _Floats, numbers: _Doubles, out: _Doubles) -> None:
    """Write the coordinate that instruction `op` makes of coordinates x, y, z (n,) and values a (n,)."""
    if op == ops.AFFINE:
        for i in range(out.size):
            out[i] = x[i] * numbers[0] + numbers[1]
    elif op == ops.TURN:
        for i in range(out.size):
            out[i] = x[i] * numbers[0] + y[i] * numbers[1] + z[i] * numbers[2]
    elif op == ops.REPEAT:
        for i in range(out.size):
            out[i] = x[i] - numbers[0] * cell(x[i], numbers[0], numbers[1])
    elif op == ops.CELL:
        for i in range(out.size):
            out[i] = cell(x[i], numbers[0], numbers[1])
    else:
        for i in range(out.size):
            out[i] = x[i] + np.float64(a[i])


@inlined
def cell(x: float, period: float, inverse: float) -> float:
    """Return the number of the period around x: from half a period below its middle to just under half of one above.

    `nearest` alone would give the border between two periods to the even one of them.
    """
    number = nearest(x * inverse)[0]
    return number + 1.0 if x - period * number >= 0.5 * period else number
