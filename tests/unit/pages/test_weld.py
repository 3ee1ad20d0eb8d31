"""Points that are equal become one; an edge is open where triangles do not walk it both ways."""

import numpy as np
import pytest

from pages.weld import edges, weld

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def test_equal_points_become_one():
    points = np.array([[5, -7, 1 << 40], [4, -7, 1 << 40], [5, -7, 1 << 40], [5, -6, 1 << 40]])
    welded, number = weld(points)
    assert welded[number].tolist() == points.tolist()
    assert len(welded) == 3
    assert number[0] == number[2]


def test_points_too_far_apart_are_refused():
    weld(np.array([[0, 0, 0], [(1 << 31) - 1, (1 << 31) - 1, 1]]))
    with pytest.raises(ValueError, match="at most 63 together"):
        weld(np.array([[0, 0, 0], [1 << 31, 1 << 31, 1]]))


def test_a_closed_surface_has_no_open_edge():
    sides, balance = edges(TETRAHEDRON)
    assert sides.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert not balance.any()


def test_a_hole_is_open_all_around():
    sides, balance = edges(TETRAHEDRON[1:])
    assert sides[balance != 0].tolist() == [[0, 1], [0, 2], [1, 2]]


def test_a_triangle_that_is_turned_around_is_open():
    turned = np.concatenate([TETRAHEDRON[1:], TETRAHEDRON[:1, ::-1]])
    sides, balance = edges(turned)
    assert sides[balance != 0].tolist() == [[0, 1], [0, 2], [1, 2]]
