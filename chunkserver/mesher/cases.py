"""Case tables, derived: which triangles a cell holds, given which of its corners are inside.

One rule per face: walk each run of inside corners around the face; a segment goes from the edge that leaves the run to
the edge that enters it. Two cells that share a face apply the rule to the same signs, so their segments agree and no
hole is possible. Where a face is ambiguous (two runs), its inside corners stay apart:

     o----+----#      # inside (rock), o outside (air)
     |     .   |
     |       . |      each # is a run of its own: two segments (dotted),
     +         +      and the air between them is connected
     | .       |
     |   .     |
     #----+----o

Every crossed edge lies on two faces, leaves a run on one and enters one on the other, so the segments of a cell link to
closed loops. Each loop is triangulated. No diagonal may lie in a face of the cell: the neighbour could choose the same
diagonal, and an edge would carry four triangles. Among the rest, the worst triangle at t = 1/2 is as good as possible.
"""

from collections.abc import Iterator
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.mesher.cell import CUBE, Cell, Point

Loop = tuple[int, ...]
Triangle = tuple[int, int, int]

CUBE_TRIANGLES_MAX: Final = 5


class _Geometry(NamedTuple):
    """What the derivation asks of a cell again and again.

    turns: for each face, and each mask of its cycle's corners that are inside, the segments: (edge out, edge in).
    faces: for each edge, the mask of the faces that it lies in.
    shapes: for each triple of edges, how well shaped the triangle of their middles is.
    """

    turns: tuple[tuple[tuple[tuple[int, int], ...], ...], ...]
    faces: tuple[int, ...]
    shapes: tuple[tuple[tuple[float, ...], ...], ...]


def loops(cell: Cell, inside: int) -> list[Loop]:
    """Return the closed loops of crossed edges of a cell, each counter-clockwise seen from the air, lowest edge first.

    inside: mask of the corners that are inside.
    """
    after = _segments(cell, inside)
    crossed = {e for e, (a, b) in enumerate(cell.edges) if (inside >> a ^ inside >> b) & 1}
    assert set(after) == crossed == set(after.values()), f"case {inside:b}: an edge without one segment in, one out"
    found: list[Loop] = []
    left = crossed
    while left:
        loop = [min(left)]
        while (edge := after[loop[-1]]) != loop[0]:
            loop.append(edge)
        left = left - set(loop)
        found.append(tuple(loop))
    return found


def _segments(cell: Cell, inside: int) -> dict[int, int]:
    """Return, for each crossed edge, the edge that its segment leads to."""
    after: dict[int, int] = {}
    for face, turns in zip(cell.faces, _geometry(cell).turns, strict=True):
        for leaves, enters in turns[sum((inside >> corner & 1) << place for place, corner in enumerate(face))]:
            assert leaves not in after, f"case {inside:b}: edge {leaves} has two segments out"
            after[leaves] = enters
    return after


@cache
def _geometry(cell: Cell) -> _Geometry:
    points = [_doubled_middle(cell, edge) for edge in range(len(cell.edges))]
    return _Geometry(
        turns=tuple(tuple(tuple(_turns(cell, face, mask)) for mask in range(1 << len(face))) for face in cell.faces),
        faces=tuple(
            sum(1 << number for number, face in enumerate(cell.faces) if set(edge) <= set(face)) for edge in cell.edges
        ),
        shapes=tuple(tuple(tuple(_quality(a, b, c) for c in points) for b in points) for a in points),
    )


def _turns(cell: Cell, face: tuple[int, ...], mask: int) -> Iterator[tuple[int, int]]:
    """Yield the segments of a face: from the edge that leaves a run of inside corners to the edge that enters it.

    mask: which places of the face's cycle are inside.
    """
    for place, corner in enumerate(face):
        after = (place + 1) % len(face)
        if mask >> place & 1 and not mask >> after & 1:
            first = place
            while mask >> (first - 1) % len(face) & 1:
                first -= 1
            yield cell.edge_between(corner, face[after]), cell.edge_between(face[first - 1], face[first])


@cache
def triangulate(cell: Cell, loop: Loop) -> tuple[Triangle, ...]:
    """Return the triangles of a loop, in its own sense, without a diagonal in a face of the cell.

    Dynamic programming over the pieces of the loop: the best is the one whose worst triangle is best, then the one
    whose sum is; ties go to the lowest edge number.
    """
    geometry, size = _geometry(cell), len(loop)
    best: dict[tuple[int, int], tuple[float, float, int]] = {(i, i + 1): (1.0, 0.0, 0) for i in range(size - 1)}
    for span in range(2, size):
        for i in range(size - span):
            j = i + span
            if span < size - 1 and geometry.faces[loop[i]] & geometry.faces[loop[j]]:
                continue
            choices = []
            for k in range(i + 1, j):
                if (i, k) in best and (k, j) in best:
                    left, right, shape = best[i, k], best[k, j], geometry.shapes[loop[i]][loop[k]][loop[j]]
                    choices.append((min(left[0], right[0], shape), left[1] + right[1] + shape, -loop[k], k))
            if choices:
                worst, total, _, k = max(choices)
                best[i, j] = worst, total, k
    assert (0, size - 1) in best, f"loop {loop} has no triangulation without a diagonal in a face"

    def pieces(i: int, j: int) -> tuple[Triangle, ...]:
        k = best[i, j][2]
        return (*pieces(i, k), (loop[i], loop[k], loop[j]), *pieces(k, j)) if j - i > 1 else ()

    return pieces(0, size - 1)


def _doubled_middle(cell: Cell, edge: int) -> Point:
    """Return twice the position of the edge's middle: integers."""
    (ax, ay, az), (bx, by, bz) = (cell.corners[corner] for corner in cell.edges[edge])
    return ax + bx, ay + by, az + bz


def _quality(a: Point, b: Point, c: Point) -> float:
    """Return 1 for an equilateral triangle, 0 for a flat one: 12 |u x v|^2 / (sum of squared sides)^2."""
    u, v, w = (tuple(q - p for p, q in zip(s, t, strict=True)) for s, t in ((a, b), (a, c), (b, c)))
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    sides = sum(x * x for side in (u, v, w) for x in side)
    return 12 * sum(x * x for x in cross) / sides**2 if sides else 0.0


def case_triangles(cell: Cell, inside: int) -> tuple[Triangle, ...]:
    """Return the triangles of one case as triples of edge numbers, counter-clockwise seen from the air."""
    return tuple(triangle for loop in loops(cell, inside) for triangle in triangulate(cell, loop))


def bake(cell: Cell, triangles_max: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return the tables that a kernel reads: triangles per case, and their edges.

    counts: (cases,) int64, which add up without overflow whether compiled or not.
    edges: (cases, 3 * triangles_max) uint8, C order, 255 where a case has no more triangles.
    """
    cases = 1 << len(cell.corners)
    counts = np.zeros(cases, np.int64)
    edges = np.full((cases, 3 * triangles_max), 255, np.uint8)
    for case in range(cases):
        flat = [edge for triangle in case_triangles(cell, case) for edge in triangle]
        assert len(flat) <= 3 * triangles_max, f"case {case:b} has {len(flat) // 3} triangles"
        counts[case] = len(flat) // 3
        edges[case, : len(flat)] = flat
    return counts, edges


class LoopTable(NamedTuple):
    """All cases of a cell, each as its loops: cases share them.

    counts: (cases,) uint8, triangles of a case.
    firsts: (cases + 1,) uint16, where a case's loops begin in `loops`: (n,) uint16, their numbers.
    loop_firsts: (loops + 1,) uint16, where a loop's triangles begin in `triangles`: (n, 3) uint8, edges.
    """

    counts: NDArray[np.uint8]
    firsts: NDArray[np.uint16]
    loops: NDArray[np.uint16]
    loop_firsts: NDArray[np.uint16]
    triangles: NDArray[np.uint8]


def loop_table(cell: Cell) -> LoopTable:
    """Return the table of a cell with so many cases that each has the numbers of its loops alone."""
    by_case = [loops(cell, case) for case in range(1 << len(cell.corners))]
    numbers = {loop: number for number, loop in enumerate(dict.fromkeys(loop for found in by_case for loop in found))}
    pieces = [triangulate(cell, loop) for loop in numbers]
    firsts = np.cumsum([0, *map(len, by_case)])
    loop_firsts = np.cumsum([0, *map(len, pieces)])
    assert max(firsts[-1], loop_firsts[-1]) < 1 << 16, "more loops or triangles than 16 bits number"
    return LoopTable(
        counts=np.array([sum(len(pieces[numbers[loop]]) for loop in found) for found in by_case], np.uint8),
        firsts=firsts.astype(np.uint16),
        loops=np.array([numbers[loop] for found in by_case for loop in found], np.uint16),
        loop_firsts=loop_firsts.astype(np.uint16),
        triangles=np.array([triangle for piece in pieces for triangle in piece], np.uint8),
    )


CUBE_COUNTS, CUBE_EDGES = bake(CUBE, CUBE_TRIANGLES_MAX)
