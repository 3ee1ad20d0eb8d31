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

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.mesher.cell import CUBE, Cell, Point

Loop = tuple[int, ...]
Triangle = tuple[int, int, int]

CUBE_TRIANGLES_MAX: Final = 5


class _Fan(NamedTuple):
    """A triangulated piece of a loop: compared by its worst triangle, then by the sum of all."""

    worst: float
    total: float
    triangles: tuple[Triangle, ...]


_NO_TRIANGLE: Final = _Fan(1.0, 0.0, ())


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
    for face in cell.faces:
        for place, corner in enumerate(face):
            follower = face[(place + 1) % len(face)]
            if inside >> corner & 1 and not inside >> follower & 1:
                first = place
                while inside >> face[first - 1] & 1:
                    first -= 1
                leaves = cell.edge_between(corner, follower)
                assert leaves not in after, f"case {inside:b}: edge {leaves} has two segments out"
                after[leaves] = cell.edge_between(face[first - 1], face[first])
    return after


def triangulate(cell: Cell, loop: Loop) -> tuple[Triangle, ...]:
    """Return the triangles of a loop, in its own sense, without a diagonal in a face of the cell.

    Dynamic programming over the pieces of the loop; ties go to the lowest edge number.
    """
    faces = {edge: _faces_of(cell, edge) for edge in loop}
    points = {edge: _doubled_middle(cell, edge) for edge in loop}
    size = len(loop)

    best: dict[tuple[int, int], _Fan | None] = {(i, i + 1): _NO_TRIANGLE for i in range(size - 1)}
    for span in range(2, size):
        for i in range(size - span):
            j = i + span
            is_diagonal = span < size - 1
            choices: list[tuple[_Fan, int]] = []
            for k in range(i + 1, j):
                left, right = best[i, k], best[k, j]
                if left is not None and right is not None:
                    triangle = (loop[i], loop[k], loop[j])
                    shape = _quality(*(points[edge] for edge in triangle))
                    fan = _Fan(
                        min(left.worst, right.worst, shape),
                        left.total + right.total + shape,
                        (*left.triangles, triangle, *right.triangles),
                    )
                    choices.append((fan, -loop[k]))
            blocked = is_diagonal and bool(faces[loop[i]] & faces[loop[j]])
            best[i, j] = (
                None if blocked or not choices else max(choices, key=lambda c: (c[0].worst, c[0].total, c[1]))[0]
            )
    whole = best[0, size - 1]
    assert whole is not None, f"loop {loop} has no triangulation without a diagonal in a face"
    return whole.triangles


def _faces_of(cell: Cell, edge: int) -> frozenset[int]:
    return frozenset(number for number, face in enumerate(cell.faces) if set(cell.edges[edge]) <= set(face))


def _doubled_middle(cell: Cell, edge: int) -> Point:
    """Return twice the position of the edge's middle: integers."""
    (ax, ay, az), (bx, by, bz) = (cell.corners[corner] for corner in cell.edges[edge])
    return ax + bx, ay + by, az + bz


def _quality(a: Point, b: Point, c: Point) -> float:
    """Return 1 for an equilateral triangle, 0 for a flat one: 12 |u x v|^2 / (sum of squared sides)^2."""
    u, v, w = (tuple(q - p for p, q in zip(s, t, strict=True)) for s, t in ((a, b), (a, c), (b, c)))
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    sides = sum(x * x for side in (u, v, w) for x in side)
    return 12 * sum(x * x for x in cross) / sides**2


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


CUBE_COUNTS, CUBE_EDGES = bake(CUBE, CUBE_TRIANGLES_MAX)
