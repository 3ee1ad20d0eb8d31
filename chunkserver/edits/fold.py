"""What strokes do to deltas: the formulas of `docs/edits/strokes.md`, but for those in `drawing.py`.

Whatever is no integer is rounded by one rule, floor(x + 1/2), so the same strokes make the same deltas on any machine.
"""

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import Arena
from chunkserver.edits.brushes import ADD, CARVE, DEPTH, STRENGTH, write_distances
from chunkserver.edits.cubes import Cubes
from chunkserver.edits.page import Page, gather, put
from chunkserver.edits.runs import Run
from chunkserver.edits.strokes import UNITS_PER_VOXEL
from chunkserver.kernel import choose, kernel

_Deltas = NDArray[np.int32]
_Ints = NDArray[np.int64]
_Flags = NDArray[np.bool_]
_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]


def fold(arena: Arena, run: Run, cubes: Cubes, page: Page) -> None:
    """Change bricks by strokes, one after the other, that are not worked out alone.

    Deltas stay within DELTA_MAX, which is not checked here: `Headroom` refuses what could pass it. cubes, page: the
    bricks that their boxes meet.
    """
    of = run.of
    sides = of.boxes[:, 1] - of.boxes[:, 0] + 1
    most = int(sides.prod(axis=1).max())
    deltas, distances, along = np.empty(most, np.int32), np.empty(most), np.empty((3, int(sides.max())))
    plain = arena.deltas.reshape(-1)
    _fold(plain, *of, *page, cubes.grids, cubes.starts, run.field, run.starts, deltas, distances, along)


@kernel
def _fold(
    arena: _Deltas,
    ops: _Ints,
    shapes: _Ints,
    numbers: _Doubles,
    boxes: _Ints,
    slots: _Deltas,
    owned: _Flags,
    spare: _Deltas,
    used: _Ints,
    grids: _Deltas,
    begins: _Ints,
    field: _Floats,
    starts: _Ints,
    deltas: _Deltas,
    distances: _Doubles,
    along: _Doubles,
) -> None:
    """begins: where the grid of each begins. deltas, distances: (points of the largest box,); along: (3, its side)."""
    for n in range(ops.size):
        op, p, box, start, grid = ops[n], numbers[n], boxes[n], starts[n], grids[begins[n] :]
        gather(arena, slots, grid, box, deltas)
        for axis in range(3):
            low, count = box[0, axis], box[1, axis] - box[0, axis] + 1
            for i in range(count):
                along[axis, i] = np.float64(low + i) - p[axis]
        points = (box[1, 0] - box[0, 0] + 1) * (box[1, 1] - box[0, 1] + 1) * (box[1, 2] - box[0, 2] + 1)
        write_distances(shapes[n], p, along, box, distances)
        if op == ADD:
            _add(p[STRENGTH] * UNITS_PER_VOXEL, p[DEPTH], distances, points, deltas)
        else:
            _cut(op == CARVE, distances, field, start, points, deltas)
        put(arena, slots, owned, spare, used, grid, box, deltas)


@kernel
def _cut(carve: bool, distance: _Doubles, field: _Floats, start: int, points: int, deltas: _Deltas) -> None:
    """Make air, or rock, where there is none and the shape wants it."""
    side, first = -1.0 if carve else 1.0, np.uint64(start)
    for i in range(np.uint64(points)):
        wanted = np.int32(np.floor((side * distance[i] - np.float64(field[first + i])) * UNITS_PER_VOXEL + 0.5))
        deltas[i] = choose((deltas[i] < wanted) == carve, wanted, deltas[i])


@kernel
def _add(units: float, depth: float, distance: _Doubles, points: int, deltas: _Deltas) -> None:
    """Make the density less by so many units where the shape is deepest, and by nothing at its border."""
    for i in range(np.uint64(points)):
        u = -distance[i] / depth
        u = choose(u > 0.0, u, 0.0)
        u = choose(u < 1.0, u, 1.0)
        deltas[i] -= np.int32(np.floor(units * (u * u * (3.0 - 2.0 * u)) + 0.5))
