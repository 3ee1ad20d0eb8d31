"""Which cubes of a lattice some boxes meet, each cube once: the bricks of strokes, the chunks that read them.

boxes    |--a--|
            |--b--|
cubes  : 0 : 1 : 2 :        grids: 0 1, 1 2; hull of cube 1: both boxes, and what lies between
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import inlined, kernel

_Ints = NDArray[np.int64]
_Numbers = NDArray[np.int32]

_ROOM: Final = 8
"""Cubes that a box is thought to meet; if it is more, they are counted first."""
_FREE: Final = -1
_LOW_BITS: Final = (1 << 31) - 1
_FACTORS: Final = (0x2C1B3C6D, 0x297A2D39, 0x1B56C4E9, 0x3504F333)
"""Odd and below 2^30: a product with 31 bits is no overflow."""


class Cubes(NamedTuple):
    """The cubes that boxes meet.

    keys: (cubes, 4) int64: group, and x, y, z in cubes, each once, as boxes come to them.
    hulls: (cubes, 2, 3) int64: first and last point x, y, z of all boxes that meet a cube.
    grids: (n,) int32: the numbers of the cubes of each box, (y, z, x), one box after the other. starts: (boxes,) int64,
        where each of these begins; a box without points has none.
    """

    keys: _Ints
    hulls: _Ints
    grids: _Numbers
    starts: _Ints

    def places(self) -> list[tuple[int, int, int, int]]:
        """Return keys: group, x, y, z."""
        return [(group, x, y, z) for group, x, y, z in self.keys.tolist()]

    def parts(self, bits: int) -> _Ints:
        """Return what the hulls have of each cube of 2^bits points a side: (cubes, 2, 3) int64."""
        first = self.keys[:, None, 1:] << bits
        return np.asarray(np.clip(self.hulls, first, first + (1 << bits) - 1))


def met(groups: _Ints, boxes: _Ints, bits: int) -> Cubes:
    """Return the cubes of 2^bits points a side that boxes meet.

    groups: (boxes,) int64, at least 0: cubes of different groups are different ones; their levels, for instance.
    boxes: (boxes, 2, 3) int64: first and last point x, y, z.
    """
    starts, room = np.empty(len(boxes), np.int64), _ROOM * len(boxes)
    while True:
        keys, hulls, grids = np.empty((room, 4), np.int64), np.empty((room, 2, 3), np.int64), np.empty(room, np.int32)
        table = np.full(1 << (2 * room).bit_length(), _FREE, np.int32)
        count, wanted = _meet(groups, boxes, bits, table, keys, hulls, grids, starts)
        if wanted <= room:
            return Cubes(keys[:count], hulls[:count], grids[:wanted], starts)
        room = int(wanted)


def joined(cubes: _Ints) -> _Ints:
    """Return boxes of cubes that do not overlap, of all that are given: runs along x, joined along z, then along y.

    cubes: (n, 4) int64, group and x, y, z of each, all different ones.

    Returns (boxes, 7) int64: group, first x, y, z, last x, y, z; in the order of groups.
    """
    boxes = np.concatenate([cubes, cubes[:, 1:]], axis=1)
    for first in (1, 3, 2):
        last = first + 3
        others = [column for column in range(7) if column not in (first, last)]
        boxes = boxes[np.lexsort((boxes[:, first], *boxes[:, others[::-1]].T))]
        begins = np.ones(len(boxes) + 1, np.bool_)
        begins[1:-1] = (boxes[1:, others] != boxes[:-1, others]).any(axis=1)
        begins[1:-1] |= boxes[1:, first] != boxes[:-1, last] + 1
        ends = boxes[begins[1:], last]
        boxes = boxes[begins[:-1]]
        boxes[:, last] = ends
    return boxes


@inlined
def _hashed(group: int, x: int, y: int, z: int) -> int:
    """Return a number of 62 bits for a key; it is no part of any result."""
    a, b, c, d = _FACTORS
    found = ((x ^ (x >> 31)) & _LOW_BITS) * a ^ ((y ^ (y >> 31)) & _LOW_BITS) * b
    found ^= ((z ^ (z >> 31)) & _LOW_BITS) * c ^ (group & _LOW_BITS) * d
    return found ^ (found >> 29) ^ (found >> 47)


@kernel
def _meet(
    groups: _Ints,
    boxes: _Ints,
    bits: int,
    table: _Numbers,
    keys: _Ints,
    hulls: _Ints,
    grids: _Numbers,
    starts: _Ints,
) -> tuple[int, int]:
    """Write the cubes of all boxes. Return how many there are, and how many all grids have; none if that is too many.

    table: (2^k,) scratch, numbers of cubes by their hash, _FREE where there is none.
    """
    wanted = 0
    for n in range(groups.size):
        starts[n], size = wanted, 1
        for axis in range(3):
            low, high = boxes[n, 0, axis], boxes[n, 1, axis]
            size *= (high >> bits) - (low >> bits) + 1 if high >= low else 0
        wanted += size
    if wanted > grids.size:
        return 0, wanted
    count, mask = 0, table.size - 1
    for n in range(groups.size):
        group, x0, y0, z0 = groups[n], boxes[n, 0, 0] >> bits, boxes[n, 0, 1] >> bits, boxes[n, 0, 2] >> bits
        along, across = (boxes[n, 1, 0] >> bits) - x0 + 1, (boxes[n, 1, 2] >> bits) - z0 + 1
        end = starts[n + 1] if n + 1 < groups.size else wanted
        for to in range(starts[n], end):
            step = to - starts[n]
            x, y, z = x0 + step % along, y0 + step // (along * across), z0 + step // along % across
            at = _hashed(group, x, y, z) & mask
            cube = table[at]
            while cube >= 0 and (
                keys[cube, 1] != x or keys[cube, 2] != y or keys[cube, 3] != z or keys[cube, 0] != group
            ):
                at = (at + 1) & mask
                cube = table[at]
            if cube < 0:
                cube = table[at] = count
                count += 1
                keys[cube, 0], keys[cube, 1], keys[cube, 2], keys[cube, 3] = group, x, y, z
                for axis in range(3):
                    hulls[cube, 0, axis], hulls[cube, 1, axis] = boxes[n, 0, axis], boxes[n, 1, axis]
            for axis in range(3):
                hulls[cube, 0, axis] = min(hulls[cube, 0, axis], boxes[n, 0, axis])
                hulls[cube, 1, axis] = max(hulls[cube, 1, axis], boxes[n, 1, axis])
            grids[to] = cube
    return count, wanted
