"""Deltas of coarser levels: filtered by 1 2 1 along each axis, so that what is thin fades with everything else."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK, BRICK_BITS, BRICK_DELTAS, Arena
from chunkserver.edits.cubes import Cubes, met
from chunkserver.edits.page import Page, gather, put
from chunkserver.kernel import kernel, spliced

FINE_MAX: Final = 2 * BRICK + 1
"""Points a side that a brick reads of the level below."""
_AROUND: Final = np.array([[-1], [1]])

_Ints = NDArray[np.int32]
_Places = NDArray[np.int64]
_Flags = NDArray[np.bool_]


def filter_up(arena: Arena, parts: _Places, cubes: Cubes, page: Page) -> None:
    """Work out deltas of parts of bricks, one after the other, for which a brick is owned that they read.

    parts: (n, 2, 3) int64, first and last point x, y, z of parts, each within a brick; those of finer levels first.
    cubes, page: the bricks that they read, as `read_by` has them.
    """
    scratch = np.empty(FINE_MAX**3, np.int32), np.empty(FINE_MAX, np.int64), np.empty(BRICK_DELTAS, np.int32)
    _filter_up(arena.deltas.reshape(-1), *page, cubes.grids, cubes.starts, finer(parts), parts, *scratch)


def read_by(lods: _Places, parts: _Places) -> Cubes:
    """Return the bricks that parts of levels read of the levels below, all of them; then those that they are parts of.

    lods: (n,) int64. parts: (n, 2, 3) int64, as `filter_up` takes them.
    """
    return met(np.concatenate([lods - 1, lods]), np.concatenate([finer(parts), parts]), BRICK_BITS)


def finer(parts: _Places) -> _Places:
    """Return the boxes of the level below that boxes of a level read: (n, 2, 3) int64."""
    return np.asarray(2 * parts + _AROUND)


def bricks_met(boxes: _Places, lods: _Places) -> Cubes:
    """Return the bricks of levels that what changes in boxes of LOD 0 can change, level by level.

    boxes: (n, 2, 3) int64, first and last point x, y, z, each with a point. lods: (levels,) int64.
    """
    levels = lods[:, None, None]
    coarse = np.empty((len(lods), *boxes.shape), np.int64)
    coarse[:, :, 0] = boxes[:, 0] >> levels
    coarse[:, :, 1] = -(-boxes[:, 1] >> levels)  # a point reads points a step farther of the level below
    return met(lods.repeat(len(boxes)), coarse.reshape(-1, 2, 3), BRICK_BITS)


@kernel
def _filter_up(
    arena: _Ints,
    slots: _Ints,
    owned: _Flags,
    spare: _Ints,
    used: _Places,
    grids: _Ints,
    starts: _Places,
    fine: _Places,
    coarse: _Places,
    points: _Ints,
    sums: _Places,
    halved: _Ints,
) -> None:
    """points, sums, halved: scratch for what a brick reads, a row of that, and the brick."""
    count = len(coarse)
    for n in range(count):
        changes = False
        for at in range(starts[n], starts[n + 1]):
            changes |= owned[grids[at]]
        if changes:
            gather(arena, slots, grids[starts[n] :], fine[n], points)
            width, rows = fine[n, 1, 0] - fine[n, 0, 0] + 1, fine[n, 1, 2] - fine[n, 0, 2] + 1
            planes = coarse[n, 1, 1] - coarse[n, 0, 1] + 1
            halve(points, rows, width, sums, halved[: planes * (rows // 2) * (width // 2)])
            put(arena, slots, owned, spare, used, grids[starts[count + n] :], coarse[n], halved)


@spliced
def halve(fine: _Ints, rows: int, width: int, sums: NDArray[np.int64], coarse: _Ints) -> None:
    """Write the 27 products with weights 1 2 1 of each axis, summed exactly, then rounded: (sum + 32) >> 6.

    fine: (2 y + 1, rows, width), C order. sums: (width,) scratch. coarse: (y * z * x,) out.
    """
    two, one = np.uint64(2), np.uint64(1)
    row, plane = np.uint64(width), np.uint64(rows) * np.uint64(width)
    across, deep = row // two, np.uint64(rows) // two
    for to in range(np.uint64(coarse.size) // across):
        a = two * (to // deep) * plane + two * (to % deep) * row
        b, c = a + plane, a + two * plane
        for i in range(row):
            low = np.int64(fine[a + i]) + 2 * np.int64(fine[a + row + i]) + np.int64(fine[a + two * row + i])
            middle = np.int64(fine[b + i]) + 2 * np.int64(fine[b + row + i]) + np.int64(fine[b + two * row + i])
            high = np.int64(fine[c + i]) + 2 * np.int64(fine[c + row + i]) + np.int64(fine[c + two * row + i])
            sums[i] = low + 2 * middle + high
        for i in range(across):
            total = sums[two * i] + 2 * sums[two * i + one] + sums[two * i + two]
            coarse[to * across + i] = np.int32((total + 32) >> 6)
