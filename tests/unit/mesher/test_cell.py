"""Cells as graphs: numbered as their pictures say, and closed, consistently oriented polyhedra."""

from collections import Counter
from itertools import combinations

import numpy as np

from chunkserver.mesher.cell import CUBE, TRANSITION


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


def test_the_transition_cell_is_numbered_as_its_picture_says():
    assert TRANSITION.corners[:9] == tuple((u, v, 1) for v in range(3) for u in range(3))
    assert TRANSITION.corners[9:] == tuple((u, v, 0) for v in (0, 2) for u in (0, 2))
    assert TRANSITION.edges == (
        *((0, 1), (1, 2), (3, 4), (4, 5), (6, 7), (7, 8)),
        *((0, 3), (1, 4), (2, 5), (3, 6), (4, 7), (5, 8)),
        *((9, 10), (9, 11), (10, 12), (11, 12)),
        *((0, 9), (2, 10), (6, 11), (8, 12)),
    )


def test_each_edge_of_the_transition_cell_lies_on_two_faces_which_walk_it_opposite_ways():
    walks = Counter(walk for face in TRANSITION.faces for walk in zip(face, (*face[1:], face[0]), strict=True))
    assert set(walks.values()) == {1}
    assert all((b, a) in walks for a, b in walks)
    assert {tuple(sorted(walk)) for walk in walks} == set(TRANSITION.edges)
    assert sorted(map(len, TRANSITION.faces)) == [4] * 5 + [5] * 4


def test_faces_of_the_transition_cell_are_flat_and_clockwise_seen_from_outside():
    corners = 2 * np.array(TRANSITION.corners)
    for face in TRANSITION.faces:
        points = corners[list(face)]
        area = sum(np.cross(a, b) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True))
        inwards = np.array([2, 2, 1]) - points[0]
        assert np.dot(area, inwards) > 0
        assert not ((points - points[0]) @ area).any()
