"""What one stroke does to the deltas of a box: the formulas of `docs/edits/strokes.md`.

Whatever is no integer is rounded by one rule, floor(x + 1/2), so the same strokes make the same deltas on any machine.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.boxes import Box
from chunkserver.edits.brushes import DEPTH, Brush, distances
from chunkserver.edits.reading import VOXELS_PER_UNIT
from chunkserver.edits.strokes import FIELD_MAX, UNITS_PER_VOXEL, Add, Carve, Delta, Fill, Flatten, Smooth, Stroke, unit
from chunkserver.kernel import choose, kernel

Field = Callable[[Box], NDArray[np.float32]]
"""The densities of LOD 0 before any edit over a box: (y, z, x) float32, C order, voxels, within FIELD_MAX."""

_ONE_VOXEL: Final = (1.0, 1.0, 1.0)
_Deltas = NDArray[np.int32]
_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]


def margin(stroke: Stroke) -> int:
    """Return how many points around its box a stroke reads."""
    return 1 if isinstance(stroke, Smooth) else 0


def fold(stroke: Stroke, of: Brush, field: Field, deltas: _Deltas) -> None:
    """Change deltas by a stroke.

    of: `brush(stroke)`.
    deltas: (y, z, x) int32, C order, units, in and out: those of the brush's box, grown by `margin(stroke)`, where they
        are only read. They stay within DELTA_MAX, which is not checked here: `Headroom` refuses what could pass it.
    """
    if isinstance(stroke, Delta):
        deltas += stroke.deltas()
        return
    box, depth = of.box, float(of.numbers[DEPTH])
    distance = distances(of, box.low, _ONE_VOXEL, box.shape)
    match stroke:
        case Carve():
            _carve(distance.reshape(-1), field(box).reshape(-1), deltas.reshape(-1))
        case Fill():
            _fill(distance.reshape(-1), field(box).reshape(-1), deltas.reshape(-1))
        case Add(strength=strength):
            _add(strength * UNITS_PER_VOXEL, depth, distance.reshape(-1), deltas.reshape(-1))
        case Flatten(strength=strength, point=point, normal=normal):
            before = _densities(field(box), deltas)
            deltas += _drawn(before, _plane(box, point, unit(normal)), strength * _weight(distance, depth))
        case Smooth(strength=strength):
            before = _densities(field(box.grown(1)), deltas)
            inner = (slice(1, -1),) * 3
            deltas[inner] += _drawn(before[inner], _mean(before), strength * _weight(distance, depth))


@kernel
def _carve(distance: _Doubles, field: _Floats, deltas: _Deltas) -> None:
    for i in range(np.uint64(deltas.size)):
        wanted = np.int32(np.floor((-distance[i] - np.float64(field[i])) * UNITS_PER_VOXEL + 0.5))
        deltas[i] = choose(deltas[i] < wanted, wanted, deltas[i])


@kernel
def _fill(distance: _Doubles, field: _Floats, deltas: _Deltas) -> None:
    for i in range(np.uint64(deltas.size)):
        wanted = np.int32(np.floor((distance[i] - np.float64(field[i])) * UNITS_PER_VOXEL + 0.5))
        deltas[i] = choose(deltas[i] > wanted, wanted, deltas[i])


@kernel
def _add(units: float, depth: float, distance: _Doubles, deltas: _Deltas) -> None:
    for i in range(np.uint64(deltas.size)):
        u = -distance[i] / depth
        u = choose(u > 0.0, u, 0.0)
        u = choose(u < 1.0, u, 1.0)
        deltas[i] -= np.int32(np.floor(units * (u * u * (3.0 - 2.0 * u)) + 0.5))


def _densities(field: _Floats, deltas: _Deltas) -> _Doubles:
    """Return what samples become, as float64: rounded to float32 as they are read."""
    return (field.astype(np.float64) + deltas * VOXELS_PER_UNIT).astype(np.float32).astype(np.float64)


def _weight(distance: _Doubles, depth: float) -> _Doubles:
    """Return 0 on a shape's border and outside, 1 where it is deepest, with no edge at either."""
    u = np.clip(-distance / depth, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def _drawn(before: _Doubles, target: _Doubles, share: _Doubles) -> _Deltas:
    """Return by how many units densities change that are drawn so far towards a target."""
    return np.floor(share * (target - before) * UNITS_PER_VOXEL + 0.5).astype(np.int32)


def _plane(box: Box, point: tuple[float, ...], normal: tuple[float, ...]) -> _Doubles:
    """Return the distance from a plane, within what the field is clamped to, positive on the normal's side."""
    x, y, z = (
        (np.arange(low, high + 1, dtype=np.float64) - at) * along
        for low, high, at, along in zip(*box, point, normal, strict=True)
    )
    return np.clip(x[None, None, :] + y[:, None, None] + z[None, :, None], -float(FIELD_MAX), float(FIELD_MAX))


def _mean(values: _Doubles) -> _Doubles:
    """Return the 1 2 1 mean along x, then z, then y, of all but the outermost values."""
    for axis in (2, 1, 0):
        along = np.moveaxis(values, axis, 0)
        values = np.moveaxis((along[:-2] + 2.0 * along[1:-1] + along[2:]) * 0.25, 0, axis)
    return values
