"""Strokes for which there is no kernel: delta; smooth and flatten, which draw densities towards others.

The formulas are those of `docs/edits/strokes.md`. Densities are read as chunks read them.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.brushes import DEPTH, NORMAL, POINT, SMOOTH, STRENGTH, Brushes, write_distances
from chunkserver.edits.reading import VOXELS_PER_UNIT
from chunkserver.edits.strokes import FIELD_MAX, UNITS_PER_VOXEL

_LIMIT: Final = float(FIELD_MAX)

_Deltas = NDArray[np.int32]
_Doubles = NDArray[np.float64]


def margin(of: Brushes) -> int:
    """Return how many points around its box a stroke reads. of: the one stroke."""
    return int(of.ops[0] == SMOOTH)


def drawn(of: Brushes, field: NDArray[np.float32], deltas: _Deltas) -> _Deltas:
    """Return the new deltas of the box of a smooth or flatten: (y, z, x) int32.

    of: the one stroke. field, deltas: (y, z, x) float32, voxels, and int32, units, of its box grown by `margin`.
    """
    p, box = of.numbers[0], of.boxes[0]
    inner = (slice(1, -1),) * 3 if margin(of) else (slice(None),) * 3
    before = (field.astype(np.float64) + deltas * VOXELS_PER_UNIT).astype(np.float32).astype(np.float64)
    target = _mean(before) if margin(of) else _plane(box, p)
    by = p[STRENGTH] * _weight(of) * (target - before[inner]) * UNITS_PER_VOXEL
    return np.asarray(deltas[inner] + np.floor(by + 0.5).astype(np.int32))


def _weight(of: Brushes) -> _Doubles:
    """Return 0 on a shape's border and outside, 1 where it is deepest, with no edge at either."""
    p, box = of.numbers[0], of.boxes[0]
    width, planes, rows = (box[1] - box[0] + 1).tolist()
    along = box[0, :, None] + np.arange(max(width, planes, rows)) - p[:3, None]
    distances = np.empty((planes, rows, width))
    write_distances(of.shapes[0], p, along, box, distances.reshape(-1))
    u = np.clip(-distances / p[DEPTH], 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def _plane(box: NDArray[np.int64], p: _Doubles) -> _Doubles:
    """Return the distance from a plane, within what the field is clamped to, positive on the normal's side."""
    x, y, z = ((np.arange(box[0, axis], box[1, axis] + 1) - p[POINT + axis]) * p[NORMAL + axis] for axis in range(3))
    return np.asarray(np.clip(x[None, None, :] + y[:, None, None] + z[None, :, None], -_LIMIT, _LIMIT))


def _mean(values: _Doubles) -> _Doubles:
    """Return the 1 2 1 mean along x, then z, then y, of all but the outermost values."""
    for axis in (2, 1, 0):
        along = np.moveaxis(values, axis, 0)
        values = np.moveaxis((along[:-2] + 2.0 * along[1:-1] + along[2:]) * 0.25, 0, axis)
    return values
