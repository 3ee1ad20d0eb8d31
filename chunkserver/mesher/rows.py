"""Rows along x, as bits: which corners are inside, which edges are crossed, which cells hold triangles.

A row is cut into runs of `RUN_CELLS` cells. The corners of a run are one word, that at its end included, which begins
the next run too; so a run needs no other word of its row:

    corners  (y, z)      0 0 1 1 1 0 ...     inside flags
    corners  (y, z+1)    0 1 1 1 0 0 ...
    z edges  (y, z)      0 1 0 0 1 0 ...     crossed edges: a vertex each
    x edges  (y, z)      0 1 0 0 1 ...       a row against itself, one place on

What is crossed is listed, a run after the other, so that whoever walks the list meets no run that is empty. An entry
holds the flags of its run and, above them, the slot of its first corner:

    | slot of the run: y, z, x, 2 bits for the axis | 33 flags |

A slot has `slot_bits` bits for each of y, z and x. Slots are numbers that grow along x by `SLOT_X`: the slot of a set
bit is that of its run, plus its place.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.kernel import LANES, inlined, kernel, prefetch
from chunkserver.mesher.bits import ONE, below, popcount
from chunkserver.mesher.crossing import are_rock, is_rock

RUN_CELLS: Final = 2 * LANES
RUN_BITS: Final = np.uint64(RUN_CELLS + 1)
FLAGS: Final = (ONE << RUN_BITS) - ONE
SLOT_X: Final = np.uint64(2)
"""How far a place is shifted in a slot: below are two bits for the axis."""

AHEAD: Final = np.uint64(1024)
"""So many samples before they are packed, they are asked for: as far as a row takes memory to answer. A page of memory
ends the machine's own foresight, and a plane of samples is longer than one."""

ALL_AIR: Final = 0
ALL_ROCK: Final = 1
MIXED: Final = 2

Words = NDArray[np.uint64]
_Densities = NDArray[np.float32]


def runs_of(cells: int) -> int:
    """Return into how many runs a row is cut."""
    return max(cells // RUN_CELLS, 1)


def slot_bits(cells: int) -> int:
    """Return how many bits hold the place of any corner along an axis."""
    return cells.bit_length()


@kernel
def pack(density: _Densities, side: int, apron: int, rows: Words) -> int:
    """Write the inside flags of all corners. Returns `ALL_AIR`, `ALL_ROCK` or `MIXED`.

    density: flat, `side` samples a side. rows: (y, z, run) out.
    """
    corners, _, runs = rows.shape
    cells = (corners - 1) // runs
    end, second = np.uint64(cells), np.uint64(min(LANES, cells - LANES))
    some, every = np.uint64(0), ~np.uint64(0)
    for y in range(corners):
        for run in range(runs):
            first = np.uint64(((y + apron) * side + apron) * side + apron + cells * run)
            for z in range(corners):
                prefetch(density, first + AHEAD)
                prefetch(density, first + AHEAD + np.uint64(LANES))
                flags = are_rock(density, first) | are_rock(density, first + second) << second
                flags |= np.uint64(is_rock(density[first + end])) << end
                rows[y, z, run] = flags
                some, every = some | flags, every & flags
                first += np.uint64(side)
    if some == np.uint64(0):
        return ALL_AIR
    return ALL_ROCK if every == below(end + ONE) else MIXED


@inlined
def _crossed_edges(rows: Words, y: int, z: int, run: int) -> tuple[np.uint64, np.uint64, np.uint64]:
    """Return which edges along x, y and z are crossed, by the corner of a run that they start at."""
    corners, _, runs = rows.shape
    cells = below(np.uint64((corners - 1) // runs))
    own = cells if run + 1 < runs else cells << ONE | ONE
    here = rows[y, z, run]
    above = rows[y + 1, z, run] if y + 1 < corners else here
    beside = rows[y, z + 1, run] if z + 1 < corners else here
    return (here ^ here >> ONE) & cells, (here ^ above) & own, (here ^ beside) & own


@inlined
def _mixed_cells(rows: Words, y: int, z: int, run: int) -> np.uint64:
    """Return which cells of a run have corners on both sides of the surface. There is no row behind the last one."""
    corners, _, runs = rows.shape
    if y + 1 == corners or z + 1 == corners:
        return np.uint64(0)
    a, b, c, d = rows[y, z, run], rows[y + 1, z, run], rows[y, z + 1, run], rows[y + 1, z + 1, run]
    some, every = a | b | c | d, a & b & c & d
    mixed = (some | some >> ONE) & ~(every & every >> ONE)
    return np.uint64(mixed & below(np.uint64((corners - 1) // runs)))


@kernel
def list_runs(rows: Words, bits: int, firsts: Words, edges: Words, cells: Words, ends: Words) -> None:
    """List what is crossed, in the order of y, z, run, axis.

    bits: `slot_bits`. firsts: (y, z, run, axis) out, the number of the first vertex of each run of edges; or empty.
    edges, cells: out, an entry for each run that is not empty, and room for one more. ends: (y, 2) out, how many
    vertices and how many mixed cells there are up to the end of each plane.
    """
    corners, _, runs = rows.shape
    vertices, mixed, edge, cell = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    for y in range(corners):
        for z in range(corners):
            for run in range(runs):
                slot = ((np.uint64(y) << np.uint64(bits) | np.uint64(z)) << np.uint64(bits)) + np.uint64(
                    RUN_CELLS * run
                )
                entry = slot << SLOT_X + RUN_BITS
                crossed = _crossed_edges(rows, y, z, run)
                for axis in range(3):
                    if firsts.size > 0:
                        firsts[y, z, run, axis] = vertices
                    vertices += popcount(crossed[axis])
                    edges[edge] = entry | np.uint64(axis) << RUN_BITS | crossed[axis]
                    edge += np.uint64(crossed[axis] != 0)
                found = _mixed_cells(rows, y, z, run)
                mixed += popcount(found)
                cells[cell] = entry | found
                cell += np.uint64(found != 0)
        ends[y, 0], ends[y, 1] = vertices, mixed
