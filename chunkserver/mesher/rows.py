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

    density: flat, `side` samples a side. rows: flat (y, z, run) out.
    """
    corners = side - 2 * apron
    runs = rows.size // (corners * corners)
    cells = (corners - 1) // runs
    end, second = np.uint64(cells), np.uint64(min(LANES, cells - LANES))
    some, every = np.uint64(0), ~np.uint64(0)
    for y in range(corners):
        for run in range(runs):
            first = np.uint64(((y + apron) * side + apron) * side + apron + cells * run)
            place = np.uint64(y * corners * runs + run)
            for _ in range(corners):
                prefetch(density, first + AHEAD)
                prefetch(density, first + AHEAD + np.uint64(LANES))
                flags = are_rock(density, first) | are_rock(density, first + second) << second
                flags |= np.uint64(is_rock(density[first + end])) << end
                rows[place] = flags
                place += np.uint64(runs)
                some, every = some | flags, every & flags
                first += np.uint64(side)
    if some == np.uint64(0):
        return ALL_AIR
    return ALL_ROCK if every == below(end + ONE) else MIXED


@kernel
def list_runs(rows: Words, corners: int, bits: int, firsts: Words, edges: Words, cells: Words, ends: Words) -> None:
    """List what is crossed, in the order of y, z, run, axis.

    rows: flat (y, z, run), `corners` a side. bits: `slot_bits`. firsts: flat (y, z, run, axis) out, the number of the
    first vertex of each run of edges, but for runs around which nothing is crossed; or empty. edges, cells: out, an
    entry for each run that is not empty, and room for one more. ends: (y, 2) out, how many vertices and how many mixed
    cells there are up to the end of each plane.

    Most runs lie all in air or all in rock, and so do those beside and above: that is asked first.
    """
    vertices, mixed, edge, cell = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    plane = np.uint64(rows.size // corners)
    runs = plane // np.uint64(corners)
    width = np.uint64(corners - 1) // runs
    inner, whole, last = below(width), below(width + ONE), plane - runs
    for y in range(corners):
        up = plane if y + 1 < corners else np.uint64(0)
        for place in range(plane):
            here = np.uint64(y) * plane + place
            beside = here + runs if place < last else here
            a, b, c, d = rows[here], rows[here + up], rows[beside], rows[beside + up]
            some, every = a | b | c | d, a & b & c & d
            if some == np.uint64(0) or every == whole:
                continue
            z, run = place // runs, place % runs
            entry = _slot(np.uint64(y), z, run, np.uint64(bits)) << SLOT_X + RUN_BITS
            own = whole if run + ONE == runs else inner
            crossed = (a ^ a >> ONE) & inner, (a ^ b) & own, (a ^ c) & own
            for axis in range(3):
                if firsts.size > 0:
                    firsts[np.uint64(3) * here + np.uint64(axis)] = vertices
                vertices += popcount(crossed[axis])
                edges[edge] = entry | np.uint64(axis) << RUN_BITS | crossed[axis]
                edge += np.uint64(crossed[axis] != np.uint64(0))
            found = (some | some >> ONE) & ~(every & every >> ONE) & inner
            if up > np.uint64(0) and place < last:  # there is no cell beyond the last row, or the last plane
                mixed += popcount(found)
                cells[cell] = entry | found
                cell += np.uint64(found != np.uint64(0))
        ends[y, 0], ends[y, 1] = vertices, mixed


@inlined
def _slot(y: np.uint64, z: np.uint64, run: np.uint64, bits: np.uint64) -> np.uint64:
    """Return the slot of the first corner of a run, without the axis."""
    return ((y << bits | z) << bits) + np.uint64(RUN_CELLS) * run
