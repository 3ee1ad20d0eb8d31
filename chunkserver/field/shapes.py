"""Distances: worked out in float64 and rounded to float32 once, after everything is subtracted.

Each is the Euclidean distance to the surface, negative inside, so it changes by at most as much as the point moves:
that is what the intervals build on. `numbers`: what is added (a faded shape has shrunk), the least value, the largest
of the shape's own lengths, then its own numbers, from FIRST on: at most LENGTHS lengths, then what is none.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.kernel import inlined, kernel

FIRST: Final = 3
LENGTHS: Final = 7

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]


@kernel
def distances(op: int, x: _Doubles, y: _Doubles, z: _Doubles, numbers: _Doubles, out: _Floats) -> None:
    """Write the distance of points x, y, z (n,), voxels, to the shape of instruction `op`, plus numbers[0]."""
    lift, p = numbers[0], numbers[FIRST:]
    if op == ops.PLANE:
        for i in range(out.size):
            out[i] = np.float32(_plane(x[i], y[i], z[i], p) + lift)
    elif op == ops.SPHERE:
        for i in range(out.size):
            out[i] = np.float32(_length3(x[i] - p[0], y[i] - p[1], z[i] - p[2]) - p[3] + lift)
    elif op == ops.BOX:
        for i in range(out.size):
            out[i] = np.float32(_box(x[i], y[i], z[i], p) + lift)
    elif op == ops.CAPSULE:
        for i in range(out.size):
            out[i] = np.float32(_capsule(x[i], y[i], z[i], p) + lift)
    elif op == ops.TORUS:
        for i in range(out.size):
            ring = _length2(x[i] - p[0], z[i] - p[2]) - p[3]
            out[i] = np.float32(_length2(ring, y[i] - p[1]) - p[4] + lift)
    else:
        for i in range(out.size):
            across = _length2(x[i] - p[0], z[i] - p[2]) - p[3]
            out[i] = np.float32(_corner2(across, abs(y[i] - p[1]) - p[4]) + lift)


@inlined
def _length2(x: float, y: float) -> Any:
    return np.sqrt(x * x + y * y)


@inlined
def _length3(x: float, y: float, z: float) -> Any:
    return np.sqrt(x * x + y * y + z * z)


@inlined
def _positive(x: float) -> float:
    return x if x > 0.0 else 0.0


@inlined
def _corner2(x: float, y: float) -> Any:
    """Return the distance to the corner x <= 0, y <= 0."""
    inside = x if x > y else y
    return _length2(_positive(x), _positive(y)) + (inside if inside < 0.0 else 0.0)


@inlined
def _plane(x: float, y: float, z: float, p: _Doubles) -> Any:
    """p: unit normal, offset."""
    return x * p[0] + y * p[1] + z * p[2] - p[3]


@inlined
def _box(x: float, y: float, z: float, p: _Doubles) -> Any:
    """p: centre, half extents less the rounding, rounding."""
    qx, qy, qz = abs(x - p[0]) - p[3], abs(y - p[1]) - p[4], abs(z - p[2]) - p[5]
    inside = qx if qx > qy else qy
    inside = inside if inside > qz else qz
    outside = _length3(_positive(qx), _positive(qy), _positive(qz))
    return outside + (inside if inside < 0.0 else 0.0) - p[6]


@inlined
def _capsule(x: float, y: float, z: float, p: _Doubles) -> Any:
    """p: a, b - a, radius, 1 / |b - a|^2 (0 if they are the same)."""
    dx, dy, dz = x - p[0], y - p[1], z - p[2]
    t = (dx * p[3] + dy * p[4] + dz * p[5]) * p[7]
    t = _positive(t)
    t = t if t < 1.0 else 1.0
    return _length3(dx - t * p[3], dy - t * p[4], dz - t * p[5]) - p[6]
