"""All 256 cases as geometry: segments in faces, symmetries, neighbours, and each case as a surface of its own."""

from itertools import permutations, product

import numpy as np
import pytest

from chunkserver.mesher.cases import loops
from chunkserver.mesher.cell import CUBE
from tests.surfaces import as_manifold, assert_no_degenerate, assert_watertight, volume, weld
from tests.worlds import SMALLEST, one_chunk

ALL_CASES = range(256)
CORNERS = np.array(CUBE.corners)
EDGES = np.array(CUBE.edges)
MIDDLES = CORNERS[EDGES].sum(axis=1)
"""Twice the middle of each edge: integers."""

FACES = [(axis, side) for axis in range(3) for side in (0, 1)]


def inside(case):
    """Return which corners are inside, (8,) bool."""
    return np.array([bool(case >> corner & 1) for corner in range(8)])


def segments(case):
    """Return the directed steps of a case's loops, as pairs of edges."""
    return [(loop[i - 1], loop[i]) for loop in loops(CUBE, case) for i in range(len(loop))]


def face_segments(case, axis, side):
    """Return the steps of a case's loops in one face, each as a pair of points (twice, within the face)."""
    others = [other for other in range(3) if other != axis]
    return {
        tuple(tuple(MIDDLES[edge][others].tolist()) for edge in step)
        for step in segments(case)
        if all(MIDDLES[edge][axis] == 2 * side for edge in step)
    }


def expected_segments(case, axis, side):
    """Return the same from geometry alone.

    A step belongs there if the corners on its rock side are one run of inside corners and no more of that run is left.
    Rock lies on the right of a step, seen from outside the cell, and air on its left.
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = [c for c in range(8) if CORNERS[c][axis] == side]
    rock = inside(case)
    outwards = 1 if side else -1
    crossed = [e for e, (a, b) in enumerate(EDGES) if MIDDLES[e][axis] == 2 * side and rock[a] != rock[b]]
    found = set()
    for start, end in permutations(crossed, 2):
        p, q = MIDDLES[start][[u, v]], MIDDLES[end][[u, v]]
        right = {c for c in corners if outwards * np.linalg.det([q - p, 2 * CORNERS[c][[u, v]] - p]) < 0}
        edge_neighbours = {d for c in right for d in corners if (c ^ d).bit_count() == 1} - right
        if right and all(rock[c] for c in right) and not any(rock[c] for c in edge_neighbours):
            others = [other for other in range(3) if other != axis]
            found.add(tuple(tuple(MIDDLES[edge][others].tolist()) for edge in (start, end)))
    return found


@pytest.mark.parametrize(("axis", "side"), FACES)
def test_segments_keep_rock_on_their_side_and_runs_apart(axis, side):
    for case in ALL_CASES:
        assert face_segments(case, axis, side) == expected_segments(case, axis, side), f"case {case:08b}"


@pytest.mark.parametrize("axis", range(3))
def test_neighbours_agree_on_their_face(axis):
    """Every pair of cases that can be neighbours: what one walks, the other walks back."""
    bit = 1 << axis
    low, high = ([c for c in range(8) if c & bit == side] for side in (0, bit))
    mine, theirs = ([face_segments(case, axis, side) for case in ALL_CASES] for side in (1, 0))
    pairs = 0
    for case, other in product(ALL_CASES, repeat=2):
        if all((case >> a & 1) == (other >> b & 1) for a, b in zip(high, low, strict=True)):
            pairs += 1
            assert mine[case] == {(q, p) for p, q in theirs[other]}, f"cases {case:08b} {other:08b}"
    assert pairs == 16 * 256


def symmetries():
    """Yield the 48 symmetries of the cube: whether it mirrors, and where it takes corners and edges."""
    for order, flips in product(permutations(range(3)), product((1, -1), repeat=3)):
        matrix = np.eye(3, dtype=int)[list(order)] * np.array(flips)[:, None]
        moved = ((2 * CORNERS - 1) @ matrix.T + 1) // 2
        corners = [int(x + 2 * y + 4 * z) for x, y, z in moved]
        edges = [CUBE.edge_between(corners[a], corners[b]) for a, b in CUBE.edges]
        yield round(np.linalg.det(matrix)) < 0, corners, edges


def lowest_first(loop):
    start = loop.index(min(loop))
    return tuple(loop[start:] + loop[:start])


def test_a_rotated_case_has_the_rotated_loops():
    """24 rotations; and 24 mirrors, which turn every loop around."""
    seen = []
    for mirrored, corners, edges in symmetries():
        seen.append(mirrored)
        for case in ALL_CASES:
            moved_case = sum(1 << corners[corner] for corner in range(8) if case >> corner & 1)
            moved = [[edges[edge] for edge in loop][:: -1 if mirrored else 1] for loop in loops(CUBE, case)]
            assert sorted(map(lowest_first, moved)) == loops(CUBE, moved_case)
    assert seen.count(False) == seen.count(True) == 24


def is_ambiguous(case, axis, side):
    """Whether a face has two inside corners, across from each other."""
    corners = [c for c in range(8) if CORNERS[c][axis] == side and case >> c & 1]
    return len(corners) == 2 and (corners[0] ^ corners[1]).bit_count() == 2


def test_the_complement_walks_back_except_on_ambiguous_faces():
    """Rock and air change places; on an ambiguous face the other pair of corners is kept apart."""
    ambiguous = 0
    for case, (axis, side) in product(ALL_CASES, FACES):
        back = {(q, p) for p, q in face_segments(255 - case, axis, side)}
        assert (face_segments(case, axis, side) == back) != is_ambiguous(case, axis, side)
        ambiguous += is_ambiguous(case, axis, side)
    assert ambiguous == 6 * 2 * 16


@pytest.mark.parametrize("rock", [-1, -0.01, -100])
def test_each_case_alone_in_a_chunk_is_a_closed_surface(rock):
    """27 cells around the masked corners: 256 masks, closed and manifold, with rock inside."""
    for case in range(1, 256):
        density = np.full((SMALLEST.samples,) * 3, 1, np.float32)
        density[6:8, 6:8, 6:8] = np.where(inside(case), rock, 1).reshape(2, 2, 2).swapaxes(0, 1)
        surface = weld(one_chunk(density))
        assert_watertight(surface)
        assert_no_degenerate(surface)
        assert volume(surface) > 0
        if rock == -1:
            assert as_manifold(surface).status().name == "NoError"


def test_each_case_alone_in_rock_is_a_closed_cavity():
    for case in range(1, 256):
        density = np.full((SMALLEST.samples,) * 3, -1, np.float32)
        density[6:8, 6:8, 6:8] = np.where(inside(case), 1, -1).reshape(2, 2, 2).swapaxes(0, 1)
        surface = weld(one_chunk(density))
        assert_watertight(surface)
        assert_no_degenerate(surface)
        assert volume(surface) < 0
