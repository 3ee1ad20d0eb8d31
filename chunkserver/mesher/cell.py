"""A cell as a graph: corners, edges between them, faces around it. All that a case table is derived from.

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
"""

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
