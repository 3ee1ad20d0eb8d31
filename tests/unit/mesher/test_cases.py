"""The derivation of the case table: its rules, its choice of diagonals, and that its assertions can fail."""

from itertools import combinations, pairwise

import numpy as np
import pytest

from chunkserver.mesher import cases
from chunkserver.mesher.cases import CUBE_COUNTS, CUBE_EDGES, case_triangles, loops, triangulate
from chunkserver.mesher.cell import CUBE

ALL_CASES = range(256)
LOOPS = {loop for case in ALL_CASES for loop in loops(CUBE, case)}


def faces_of(*edges):
    """Return the faces of the cube that hold all these edges."""
    return {face for face in CUBE.faces if all(set(CUBE.edges[edge]) <= set(face) for edge in edges)}


def sides(triangle):
    a, b, c = triangle
    return {(a, b), (b, c), (c, a)}


def diagonals(loop, triangles):
    """Return the undirected sides of triangles that are no sides of their loop."""
    around = {frozenset(side) for side in pairwise((*loop, loop[0]))}
    return {frozenset(side) for triangle in triangles for side in sides(triangle)} - around


def triangulations(loop):
    """Yield every way to cut a loop into triangles."""
    if len(loop) < 3:
        yield []
        return
    for middle in range(1, len(loop) - 1):
        for left in triangulations(loop[: middle + 1]):
            for right in triangulations(loop[middle:]):
                yield [*left, (loop[0], loop[middle], loop[-1]), *right]


def shapes(triangles):
    """Return (worst, sum) of the triangles' shapes with vertices in the middle of their edges."""
    corners = np.array(CUBE.corners, float)
    middle = np.array([(corners[a] + corners[b]) / 2 for a, b in CUBE.edges])
    found = []
    for a, b, c in middle[np.array(triangles)]:
        length = sum(np.dot(side, side) for side in (b - a, c - b, a - c))
        found.append(12 * np.dot(n := np.cross(b - a, c - a), n) / length**2)
    return round(min(found), 12), round(sum(found), 12)


def test_loops_visit_every_crossed_edge_once():
    for case in ALL_CASES:
        crossed = [e for e, (a, b) in enumerate(CUBE.edges) if (case >> a ^ case >> b) & 1]
        found = loops(CUBE, case)
        assert sorted(edge for loop in found for edge in loop) == crossed
        assert all(3 <= len(loop) <= 7 and loop[0] == min(loop) for loop in found)
        assert [loop[0] for loop in found] == sorted(loop[0] for loop in found)


def test_each_step_of_a_loop_crosses_one_face():
    assert all(len(faces_of(a, b)) == 1 for loop in LOOPS for a, b in pairwise((*loop, loop[0])))


def test_triangles_fill_their_loop():
    for loop in LOOPS:
        walked = [side for triangle in triangulate(CUBE, loop) for side in sides(triangle)]
        assert len(set(walked)) == len(walked) == 3 * (len(loop) - 2)
        assert {(a, b) for a, b in walked if (b, a) not in walked} == set(pairwise((*loop, loop[0])))


def test_no_diagonal_lies_in_a_face():
    for loop in LOOPS:
        assert not any(faces_of(*diagonal) for diagonal in diagonals(loop, triangulate(CUBE, loop)))


def test_diagonals_give_the_best_shapes():
    for loop in LOOPS:
        allowed = [cut for cut in triangulations(loop) if not any(faces_of(*d) for d in diagonals(loop, cut))]
        assert shapes(triangulate(CUBE, loop)) == max(map(shapes, allowed))


def test_a_square_is_cut_from_its_lowest_edge():
    """Case 15: the four corners at z = 0 are inside; the loop is a square around the z axis."""
    assert loops(CUBE, 15) == [(8, 9, 11, 10)]
    assert case_triangles(CUBE, 15) == ((8, 9, 10), (9, 11, 10))


def test_a_plain_fan_would_lie_in_a_face():
    """What the rule is for: a fan from each loop's lowest edge needs a diagonal in a face of the cell, in 18 cases."""

    def fan(loop):
        return [(loop[0], a, b) for a, b in pairwise(loop[1:])]

    wrong = [c for c in ALL_CASES if any(faces_of(*d) for loop in loops(CUBE, c) for d in diagonals(loop, fan(loop)))]
    assert len(wrong) == 18


def test_baked_table():
    assert CUBE_COUNTS.tolist() == [len(case_triangles(CUBE, case)) for case in ALL_CASES]
    assert CUBE_COUNTS.max() == 5
    assert CUBE_COUNTS.sum() == 820
    for case in ALL_CASES:
        flat = [edge for triangle in case_triangles(CUBE, case) for edge in triangle]
        assert CUBE_EDGES[case].tolist() == flat + [255] * (15 - len(flat))


def test_bake_refuses_a_case_that_does_not_fit():
    with pytest.raises(AssertionError, match="triangles"):
        cases.bake(CUBE, 4)


@pytest.mark.parametrize("number", range(6))
def test_a_face_walked_the_wrong_way_is_found(number):
    faces = list(CUBE.faces)
    faces[number] = faces[number][::-1]
    with pytest.raises(AssertionError, match="edge"):
        cases.bake(CUBE._replace(faces=tuple(faces)), 5)


@pytest.mark.parametrize("number", range(6))
def test_a_missing_face_is_found(number):
    with pytest.raises(AssertionError, match="without one segment in, one out"):
        cases.bake(CUBE._replace(faces=CUBE.faces[:number] + CUBE.faces[number + 1 :]), 5)


def test_a_loop_that_cannot_be_cut_is_found():
    """All four edges around one face: every diagonal lies in that face."""
    square = tuple(edge for edge in range(12) if faces_of(edge) & {CUBE.faces[0]})
    with pytest.raises(AssertionError, match="without a diagonal in a face"):
        triangulate(CUBE, square)


def test_all_pairs_of_edges_on_a_face_are_known():
    """`faces_of` itself: two edges share a face unless they are opposite or askew."""
    assert sum(bool(faces_of(a, b)) for a, b in combinations(range(12), 2)) == 6 * 6
