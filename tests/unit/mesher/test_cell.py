"""The cube as a graph: numbered as its picture says, and a closed, consistently oriented polyhedron."""

from collections import Counter
from itertools import combinations

import numpy as np

from chunkserver.mesher.cell import CUBE


def test_corners_are_numbered_by_bits():
    assert [x + 2 * y + 4 * z for x, y, z in CUBE.corners] == list(range(8))


def test_edges_are_numbered_by_axis_and_place():
    numbers = []
    for low, high in CUBE.edges:
        axis = {1: 0, 2: 1, 4: 2}[high - low]
        first, second = (value for other, value in enumerate(CUBE.corners[low]) if other != axis)
        numbers.append(4 * axis + first + 2 * second)
    assert numbers == list(range(12))


def test_edges_are_the_corners_one_apart():
    apart = {(a, b) for a, b in combinations(range(8), 2) if (a ^ b).bit_count() == 1}
    assert set(CUBE.edges) == apart
    assert all(CUBE.edge_between(a, b) == CUBE.edge_between(b, a) == CUBE.edges.index((a, b)) for a, b in apart)


def test_every_edge_lies_on_two_faces_which_walk_it_opposite_ways():
    walks = Counter((face[i - 1], face[i]) for face in CUBE.faces for i in range(4))
    assert set(walks.values()) == {1}
    assert {tuple(sorted(walk)) for walk in walks} == set(CUBE.edges)
    assert all((b, a) in walks for a, b in walks)


def test_faces_are_clockwise_seen_from_outside():
    corners = np.array(CUBE.corners)
    for face in CUBE.faces:
        a, b, c, d = corners[list(face)]
        inwards = np.array([1, 1, 1]) - (a + c)  # twice the way from the face's middle to the cube's
        assert (a + c == b + d).all(), "a flat square"
        assert np.dot(np.cross(b - a, c - b), inwards) > 0
