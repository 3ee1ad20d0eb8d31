"""All 8192 cases of the transition cell: their loops, their triangles, and what is beside them."""

from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from chunkserver.mesher import transitions
from chunkserver.mesher.cases import case_triangles, loop_table, loops, triangulate
from chunkserver.mesher.cell import CUBE, TRANSITION
from chunkserver.mesher.faces import FRAMES

ALL_CASES = range(8192)
TRIANGLES_MAX = 10


@cache
def loops_of(case):
    return loops(TRANSITION, case)


def shared_faces(cell, a, b):
    """Return the numbers of the faces that hold both edges."""
    both = {*cell.edges[a], *cell.edges[b]}
    return [number for number, face in enumerate(cell.faces) if both <= set(face)]


def test_loops_visit_every_crossed_edge_once():
    for case in ALL_CASES:
        crossed = [e for e, (a, b) in enumerate(TRANSITION.edges) if (case >> a ^ case >> b) & 1]
        assert sorted(edge for loop in loops_of(case) for edge in loop) == crossed


def test_at_most_ten_triangles_and_no_diagonal_in_a_face():
    for loop in {loop for case in ALL_CASES for loop in loops_of(case)}:
        around = set(pairwise((*loop, loop[0])))
        sides = [side for a, b, c in triangulate(TRANSITION, loop) for side in ((a, b), (b, c), (c, a))]
        assert {(a, b) for a, b in sides if (b, a) not in sides} == around
        assert len(sides) == len(set(sides)) == 3 * (len(loop) - 2)
        assert not any(
            shared_faces(TRANSITION, *side) for side in set(sides) if side not in around and side[::-1] not in around
        )
    assert max(len(case_triangles(TRANSITION, case)) for case in ALL_CASES) == TRIANGLES_MAX


def lowest_first(loop):
    at = loop.index(min(loop))
    return loop[at:] + loop[:at]


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turned_case_has_the_turned_loops(turns):
    number = {corner: place for place, corner in enumerate(TRANSITION.corners)}

    def turned(corner):
        u, v, w = TRANSITION.corners[corner]
        for _ in range(turns):
            u, v = v, 2 - u
        return number[u, v, w]

    corner = [turned(place) for place in range(13)]
    edge = [TRANSITION.edge_between(corner[a], corner[b]) for a, b in TRANSITION.edges]
    for case in ALL_CASES:
        there = sum((case >> place & 1) << corner[place] for place in range(13))
        assert {lowest_first(tuple(edge[e] for e in loop)) for loop in loops_of(case)} == set(loops_of(there))


def test_the_table_is_the_derivation():
    table = loop_table(TRANSITION)
    for case in ALL_CASES:
        numbers = table.loops[table.firsts[case] : table.firsts[case + 1]]
        rows = [table.triangles[table.loop_firsts[n] : table.loop_firsts[n + 1]] for n in numbers]
        found = tuple(tuple(row) for part in rows for row in part.tolist())
        assert found == case_triangles(TRANSITION, case)
        assert table.counts[case] == len(found)


def test_the_mesher_has_that_table():
    derived = loop_table(TRANSITION)
    for name in derived._fields:
        kept = getattr(transitions._table(), name)
        assert kept.dtype == getattr(derived, name).dtype
        assert np.array_equal(kept, getattr(derived, name))
    assert sum(array.nbytes for array in transitions._table()) < 1 << 17


@pytest.mark.parametrize("number", range(9))
def test_a_face_walked_the_wrong_way_is_found(number):
    faces = list(TRANSITION.faces)
    faces[number] = faces[number][::-1]
    with pytest.raises(AssertionError, match="edge"):
        loop_table(TRANSITION._replace(faces=tuple(faces)))


@cache
def segments(cell):
    """Return, for each face of a cell and the corners of it that are inside, its segments as pairs of edges.

    From the loops of all cases, so that it is seen that nothing else of a case matters.
    """
    found: dict[object, object] = {}
    for case in range(1 << len(cell.corners)):
        in_face: list[set[object]] = [set() for _ in cell.faces]
        for loop in loops(cell, case):
            for a, b in pairwise((*loop, loop[0])):
                (face,) = shared_faces(cell, a, b)
                in_face[face].add((cell.edges[a], cell.edges[b]))
        for number, face in enumerate(cell.faces):
            key = number, frozenset(corner for corner in face if case >> corner & 1)
            assert found.setdefault(key, in_face[number]) == in_face[number]
    return found


def named(cell, names):
    """Return (corners of a face, those inside) -> segments, where corners have names that cells side by side share."""
    return {
        (frozenset(names[corner] for corner in cell.faces[number]), frozenset(names[corner] for corner in inside)): {
            (frozenset(names[corner] for corner in a), frozenset(names[corner] for corner in b)) for a, b in found
        }
        for (number, inside), found in segments(cell).items()
    }


def placed_cube(low, size, level):
    return named(CUBE, [(level, *(low[axis] + size * corner[axis] for axis in range(3))) for corner in CUBE.corners])


def placed_transition(face, i, j, cells):
    """Return the transition cell at coarse corner (i, j) of a face of a chunk; names are the level and the corner."""
    u, v, w = FRAMES[face]
    names = []
    for s, t, is_fine in TRANSITION.corners:
        point = [0, 0, 0]
        point[u], point[v], point[w] = 2 * i + s, 2 * j + t, cells * (face & 1)
        names.append(("fine" if is_fine else "coarse", *point))
    return named(TRANSITION, names)


def assert_fit(one, other, faces, signs):
    """So many faces are shared; on them the two have the same segments, walked the other way."""
    shared = one.keys() & other.keys()
    assert len({face for face, _ in shared}) == faces
    assert len(shared) == faces * signs
    for key in shared:
        assert one[key] == {(b, a) for a, b in other[key]}


@pytest.mark.parametrize("face", range(6))
def test_all_cases_fit_the_cells_of_both_levels(face):
    u, v, w = FRAMES[face]
    cell = placed_transition(face, 1, 1, 6)
    for s, t in product((0, 1), repeat=2):
        low = [0, 0, 0]
        low[u], low[v], low[w] = 2 + s, 2 + t, 5 * (face & 1)
        assert_fit(cell, placed_cube(low, 1, "fine"), 1, 16)
    low[u], low[v], low[w] = 2, 2, 6 if face & 1 else -2
    assert_fit(cell, placed_cube(low, 2, "coarse"), 1, 16)


@pytest.mark.parametrize("face", range(6))
def test_all_cases_fit_the_transition_cells_beside(face):
    cell = placed_transition(face, 1, 1, 6)
    for i, j in ((0, 1), (2, 1), (1, 0), (1, 2)):
        assert_fit(cell, placed_transition(face, i, j, 6), 1, 32)


@pytest.mark.parametrize("face", range(6))
def test_all_cases_fit_the_transition_cells_of_other_faces(face):
    """In a chunk of one coarse cell, each lateral pentagon is that of another face."""
    cell = placed_transition(face, 0, 0, 2)
    for other in range(6):
        if other // 2 != face // 2:
            assert_fit(cell, placed_transition(other, 0, 0, 2), 1, 32)
