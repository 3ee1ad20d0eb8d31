"""Cells as graphs: corners, edges between them, faces around them. All that a case table is derived from.

The regular cell, y up and z towards the reader. A corner's number is made of bits, x = 1, y = 2, z = 4; an edge's
number is 4 * axis + place, where place counts the four parallel edges by the bits of the other axes, lower axis first:

          2 ----1---- 3                 edges along x: 0 (0-1)  1 (2-3)  2 (4-5)  3 (6-7)
         /|          /|                 edges along y: 4 (0-2)  5 (1-3)  6 (4-6)  7 (5-7)
       10 4        11 5                 edges along z: 8 (0-4)  9 (1-5) 10 (2-6) 11 (3-7)
       /  |        /  |
      6 ----3---- 7   |      y
      |   0 ----0-|-- 1      |
      6  /        7  /       |
      | 8         | 9        +---- x
      |/          |/        /
      4 ----2---- 5        z

The transition cell lies between a fine chunk and a coarser one, in the outer layer of the fine one. u and v run along
the border, w from it into the fine chunk; nine fine samples on one side, four coarse ones on the other:

      6 --4--- 7 --5--- 8              11 --15- 12         between a fine corner and its coarse twin:
      |        |        |               |        |             16 (0-9)  17 (2-10)  18 (6-11)  19 (8-12)
      9       10       11               |        |
      |        |        |               |        |         v
      3 --2--- 4 --3--- 5              13        14        |
      |        |        |               |        |         |
      6        7        8               |        |         +---- u
      |        |        |               |        |        /
      0 --0--- 1 --1--- 2               9 --12- 10       w
           w = 1, fine                  w = 0, coarse

Its faces are four fine quads, a coarse one, and four pentagons of three fine corners and two coarse.
"""

from itertools import pairwise
from typing import Final, NamedTuple

Point = tuple[int, int, int]


class Cell(NamedTuple):
    """A polyhedron whose corners carry samples.

    corners: position of each corner, in cell units of that cell.
    edges: (low corner, high corner) of each edge.
    faces: each face as its cycle of corners, clockwise seen from outside.
    """

    corners: tuple[Point, ...]
    edges: tuple[tuple[int, int], ...]
    faces: tuple[tuple[int, ...], ...]

    def edge_between(self, a: int, b: int) -> int:
        """Return the number of the edge between corners `a` and `b`, in either direction."""
        return self.edges.index((min(a, b), max(a, b)))


def _cube() -> Cell:
    corners = tuple((number & 1, number >> 1 & 1, number >> 2 & 1) for number in range(8))
    edges, faces = [], []
    for axis in range(3):
        bit, low_bit, high_bit = 1 << axis, *(1 << other for other in range(3) if other != axis)
        edges += [(low, low | bit) for low in (0, low_bit, high_bit, low_bit | high_bit)]
        # Around the axis in its right-handed sense (x: y to z, y: z to x, z: x to y): clockwise seen from below it.
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        below = (0, u, u | v, v)
        faces += [below, tuple(corner | bit for corner in reversed(below))]
    return Cell(corners, tuple(edges), tuple(faces))


CUBE: Final = _cube()
"""The regular cell: 8 corners, 12 edges, 6 faces."""


def _transition() -> Cell:
    def fine(u: int, v: int) -> int:
        return 3 * v + u

    def coarse(u: int, v: int) -> int:
        return 9 + v + u // 2

    corners = [(u, v, 1) for v in range(3) for u in range(3)] + [(u, v, 0) for v in (0, 2) for u in (0, 2)]
    faces: list[tuple[int, ...]] = [
        *((fine(u, v), fine(u, v + 1), fine(u + 1, v + 1), fine(u + 1, v)) for v in (0, 1) for u in (0, 1)),
        (coarse(0, 0), coarse(2, 0), coarse(2, 2), coarse(0, 2)),
    ]
    around = ((0, 0), (2, 0), (2, 2), (0, 2), (0, 0))
    for (u, v), (s, t) in pairwise(around):
        faces.append((coarse(u, v), fine(u, v), fine((u + s) // 2, (v + t) // 2), fine(s, t), coarse(s, t)))
    along_u = [(fine(u, v), fine(u + 1, v)) for v in range(3) for u in (0, 1)]
    along_v = [(fine(u, v), fine(u, v + 1)) for v in (0, 1) for u in range(3)]
    coarse_ones = [(9, 10), (9, 11), (10, 12), (11, 12)]
    twins = [(fine(u, v), coarse(u, v)) for v in (0, 2) for u in (0, 2)]
    return Cell(tuple(corners), tuple(along_u + along_v + coarse_ones + twins), tuple(faces))


TRANSITION: Final = _transition()
"""The transition cell: 9 fine corners and 4 coarse ones, 20 edges, 9 faces."""
