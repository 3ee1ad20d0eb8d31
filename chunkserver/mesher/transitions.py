r"""The border to a coarser chunk, closed in the finer one: its outer layer of cells makes room for transition cells.

    coarser chunk |    this chunk, d < 1 cell is squeezed to a quarter .. 1
                  |
        o---------+--+-o---o-     +  coarse corners, sampled from the next level's field, as the coarser chunk does
        |         |\ | |   |      o  corners of this chunk's cells
        |         | \o-o---o-
        |         |  | |   |      between the border and the squeezed layer: a transition cell for each face of a
        |         | /o-o---o-     coarse cell, 13 signs, `TRANSITION` in cell.py. Its fine side has the vertices of the
        |         |/ | |   |      regular mesh, its coarse side those that the coarser chunk has there.
        o---------+--+-o---o-

**A vertex that touches a face of the chunk that is not masked does not move**: so neighbours that know nothing of this
border still fit, and two masked faces of different chunks meet in a line. Transition cells are flat there, and
triangles with two equal corners are left out.

The levels are sampled from different fields, so a fine corner and its coarse twin may differ in sign. That edge, too,
then has a vertex: half-way between where the two corners are.
"""

from functools import cache
from operator import mul
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import FACES, POSITION_HIGH, POSITION_LOW
from chunkserver.kernel import inlined, kept, kernel
from chunkserver.mesh import POSITION_W
from chunkserver.mesher.bits import below, popcount
from chunkserver.mesher.cases import LoopTable, loop_table
from chunkserver.mesher.cell import TRANSITION
from chunkserver.mesher.crossing import crossing, is_rock
from chunkserver.mesher.normals import edge_normal, store_normal, twin_normal
from chunkserver.mesher.triangles import has_three_places
from chunkserver.samples import Samples, coarse_box

_FRAMES: Final = ((1, 2, 0), (2, 1, 0), (2, 0, 1), (0, 2, 1), (0, 1, 2), (1, 0, 2))
"""For each face the axes of a transition cell's u, v and w. w points into the chunk, and u, v, w are right-handed."""

_TWIN: Final = 3
"""The kind of an edge between a fine corner and its coarse twin; 0, 1, 2 are coarse edges along x, y, z."""

_Face = Any
"""A record of dtype `_FACE`."""
_Densities = NDArray[np.float32]
_Words = NDArray[np.uint64]
_Places = NDArray[np.uint16]
_Numbers = NDArray[np.int64]


def _edge_rows() -> _Numbers:
    """Return, for each edge of the transition cell: along u (0), along v (1) or a twin (2); coarse or not; u; v."""
    rows = []
    for low, high in TRANSITION.edges:
        (u, v, w), (s, t, r) = TRANSITION.corners[low], TRANSITION.corners[high]
        rows.append((2 if w != r else int(u == s), int(w == r == 0), min(u, s), min(v, t)))
    return np.array(rows, np.int64)


_EDGES: Final = _edge_rows()
_TABLE: Final = LoopTable(*kept("transition-cases", lambda: loop_table(TRANSITION)))

_FACE: Final = np.dtype(
    [
        *((f"fine_{name}", np.int64) for name in ("start", "u", "v")),
        *((f"coarse_{name}", np.int64) for name in ("start", "u", "v", "row", "plane")),
        *((f"number_{name}", np.int64) for name in ("start", "u", "v")),
        *((name, np.int64) for name in ("u", "v", "w", "far")),
    ]
)
"""One masked face: where its first fine sample, coarse sample and number of a vertex lie, and how far on the next ones
are along u and v, and for coarse samples in z and in y too; the axes of u, v and w; its own place on w, in cells."""


class Seams(NamedTuple):
    """What transition cells add to the regular mesh.

    mask: the faces whose neighbour is one level coarser. vertices: how many. triangles: how many, at most.
    numbers: (4, n * n * n) int32, C order, kind and x, y, z in coarse corners: the vertex on the coarse edge along x, y
        or z that starts there, or between that corner and its fine twin; -1 for none.
    faces: (masked faces,) of `_FACE`. coarse: the coarse samples, flat.
    cases: (masked faces, n - 1, n - 1) uint16, v slow and u fast: the case of each transition cell.
    """

    mask: int
    vertices: int
    triangles: int
    numbers: NDArray[np.int32]
    faces: NDArray[np.void]
    coarse: _Densities
    cases: NDArray[np.uint16]


NO_SEAMS: Final = Seams(
    mask=0,
    vertices=0,
    triangles=0,
    numbers=np.empty((4, 0), np.int32),
    faces=np.empty(0, _FACE),
    coarse=np.empty(0, np.float32),
    cases=np.empty((0, 0, 0), np.uint16),
)
"""Of a chunk whose neighbours are all of its own level."""


def count_seams(samples: Samples, first: int) -> Seams:
    """Number the vertices of all transition cells, from `first` on, and count what they add."""
    corners = samples.shape.cells // 2 + 1
    numbers = np.full((4, corners**3), -1, np.int32)
    assert samples.coarse is not None, "coarse samples come with every mask"
    faces = _faces(samples.shape.cells, samples.shape.apron, samples.coarser)
    coarse = samples.coarse.reshape(-1)
    cases = np.empty((len(faces), corners - 1, corners - 1), np.uint16)
    fine = samples.density.reshape(-1)
    vertices, triangles = _count(faces, fine, coarse, first, numbers, cases, _TABLE.counts)
    return Seams(samples.coarser, vertices, triangles, numbers, faces, coarse, cases)


def fill_seams(
    samples: Samples,
    seams: Seams,
    edges: _Words,
    firsts: _Numbers,
    positions: _Places,
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
    triangles: NDArray[np.uint32],
) -> int:
    """Make room in the regular mesh, and write what was counted. Return how many triangles that are.

    edges, firsts: of the regular mesh, see `marching_cubes`. positions: (V, 4), its vertices first.
    triangles: out, room for `seams.triangles`; those with two equal corners are left out.
    """
    shape, new = samples.shape, len(positions) - seams.vertices
    _make_room(positions[:new], seams.mask, shape.units_per_cell)
    _fill_vertices(
        seams.faces,
        samples.density.reshape(-1),
        shape.samples,
        seams.coarse,
        shape.cells // 2 + 1,
        seams.mask,
        shape.units_per_cell,
        seams.numbers,
        positions,
        as_int8,
        as_float32,
    )
    return _fill_triangles(seams.faces, seams.cases, seams.numbers, edges, firsts, positions, *_TABLE[1:], triangles)


@cache
def _faces(cells: int, apron: int, mask: int) -> NDArray[np.void]:
    """Return the masked faces of such a chunk."""
    side, corners, rows = cells + 1 + 2 * apron, cells // 2 + 1, []
    low, (_, nz, nx) = coarse_box(cells, mask)
    for face in range(FACES):
        if mask >> face & 1:
            u, v, w = _FRAMES[face]
            far = face & 1
            fine, coarse, number = (1, side * side, side), (1, nx * nz, nx), (corners * corners, corners, 1)
            first = [-place for place in low]
            first[w] += far * (corners - 1)
            rows.append(
                (
                    *(apron * sum(fine) + far * cells * fine[w], fine[u], fine[v]),
                    *(sum(map(mul, first, coarse)), coarse[u], coarse[v], nx, nx * nz),
                    *(far * (corners - 1) * number[w], number[u], number[v]),
                    *(u, v, w, far * cells),
                )
            )
    return np.array(rows, _FACE)


@inlined
def _case(face: _Face, fine: _Densities, coarse: _Densities, i: int, j: int) -> int:
    """Return the case of the transition cell at coarse corner (i, j): bit c is set if corner c is inside."""
    case = 0
    low = face.fine_start + 2 * i * face.fine_u + 2 * j * face.fine_v
    for v in range(3):
        for u in range(3):
            case |= int(is_rock(fine[low + u * face.fine_u + v * face.fine_v])) << (3 * v + u)
    low = face.coarse_start + i * face.coarse_u + j * face.coarse_v
    for v in range(2):
        for u in range(2):
            case |= int(is_rock(coarse[low + u * face.coarse_u + v * face.coarse_v])) << (9 + 2 * v + u)
    return case


@kernel
def _count(
    faces: NDArray[np.void],
    fine: _Densities,
    coarse: _Densities,
    first: int,
    numbers: NDArray[np.int32],
    cases: NDArray[np.uint16],
    triangles_of: NDArray[np.uint8],
) -> tuple[int, int]:
    """Number the vertices of all faces, each once; find the cases and count their triangles. Returns both counts."""
    corners = cases.shape[1] + 1
    vertices = triangles = 0
    for place in range(faces.size):
        face = faces[place]
        for j in range(corners):
            for i in range(corners):
                number = face.number_start + i * face.number_u + j * face.number_v
                at = face.coarse_start + i * face.coarse_u + j * face.coarse_v
                here = is_rock(coarse[at])
                if i + 1 < corners and is_rock(coarse[at + face.coarse_u]) != here and numbers[face.u, number] < 0:
                    numbers[face.u, number] = first + vertices
                    vertices += 1
                if j + 1 < corners and is_rock(coarse[at + face.coarse_v]) != here and numbers[face.v, number] < 0:
                    numbers[face.v, number] = first + vertices
                    vertices += 1
                twin = face.fine_start + 2 * i * face.fine_u + 2 * j * face.fine_v
                if is_rock(fine[twin]) != here and numbers[_TWIN, number] < 0:
                    numbers[_TWIN, number] = first + vertices
                    vertices += 1
                if i + 1 < corners and j + 1 < corners:
                    case = _case(face, fine, coarse, i, j)
                    cases[place, j, i] = case
                    triangles += int(np.int64(triangles_of[case]))
    return vertices, triangles


@inlined
def _move(positions: _Places, vertex: int, mask: int, units: int) -> None:
    """Move a vertex away from the masked faces that it is near: d < 1 cell becomes d + (1 - d) / 4, rounded half up.

    A vertex that touches a face which is not masked stays.
    """
    for axis in range(3):
        place = np.int64(positions[vertex, axis])
        if (place == POSITION_LOW and not mask >> (2 * axis) & 1) or (
            place == POSITION_HIGH and not mask >> (2 * axis + 1) & 1
        ):
            return
    for axis in range(3):
        place = np.int64(positions[vertex, axis])
        low, high = place - POSITION_LOW, POSITION_HIGH - place
        if low < units and mask >> (2 * axis) & 1:
            positions[vertex, axis] = POSITION_LOW + ((3 * low + units + 2) >> 2)
        elif high < units and mask >> (2 * axis + 1) & 1:
            positions[vertex, axis] = POSITION_HIGH - ((3 * high + units + 2) >> 2)


@kernel
def _make_room(positions: _Places, mask: int, units: int) -> None:
    """Move every vertex of the regular mesh that is in the way."""
    for vertex in range(positions.shape[0]):
        _move(positions, vertex, mask, units)


@inlined
def _put(face: _Face, i: int, j: int, units: int, positions: _Places, vertex: int) -> None:
    """Write the position of coarse corner (i, j) of a face."""
    positions[vertex, face.u] = POSITION_LOW + 2 * units * i
    positions[vertex, face.v] = POSITION_LOW + 2 * units * j
    positions[vertex, face.w] = POSITION_LOW if face.far == 0 else POSITION_HIGH
    positions[vertex, 3] = POSITION_W


@kernel
def _fill_vertices(
    faces: NDArray[np.void],
    fine: _Densities,
    side: int,
    coarse: _Densities,
    corners: int,
    mask: int,
    units: int,
    numbers: NDArray[np.int32],
    positions: _Places,
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
) -> None:
    """Write position and normal of the vertices on all faces. side: fine samples a side.

    A vertex that two faces share is written twice, with the same bits.
    """
    for face in faces:
        row, plane = face.coarse_row, face.coarse_plane
        for j in range(corners):
            for i in range(corners):
                number = face.number_start + i * face.number_u + j * face.number_v
                at = face.coarse_start + i * face.coarse_u + j * face.coarse_v
                for turn in range(2):
                    axis, along = (face.u, face.coarse_u) if turn == 0 else (face.v, face.coarse_v)
                    vertex = int(np.int64(numbers[axis, number]))
                    if vertex >= 0 and (i if turn == 0 else j) + 1 < corners:
                        units_on = crossing(coarse[at], coarse[at + along], units)
                        _put(face, i, j, units, positions, vertex)
                        positions[vertex, axis] += 2 * units_on
                        normal = edge_normal(coarse, at, at + along, row, plane, units_on * (1.0 / units))
                        store_normal(normal, vertex, as_int8, as_float32)
                vertex = int(np.int64(numbers[_TWIN, number]))
                if vertex >= 0:
                    _put(face, i, j, units, positions, vertex)
                    corner = positions[vertex, 0], positions[vertex, 1], positions[vertex, 2]
                    _move(positions, vertex, mask, units)
                    for axis in range(3):
                        positions[vertex, axis] = (np.int64(positions[vertex, axis]) + np.int64(corner[axis])) // 2
                    twin = face.fine_start + 2 * i * face.fine_u + 2 * j * face.fine_v
                    normal = twin_normal(fine, twin, side, side * side, coarse, at, row, plane)
                    store_normal(normal, vertex, as_int8, as_float32)


@kernel
def _fill_triangles(
    faces: NDArray[np.void],
    cases: NDArray[np.uint16],
    numbers: NDArray[np.int32],
    edges: _Words,
    firsts: _Numbers,
    positions: _Places,
    case_firsts: NDArray[np.uint16],
    case_loops: NDArray[np.uint16],
    loop_firsts: NDArray[np.uint16],
    loop_triangles: NDArray[np.uint8],
    triangles: NDArray[np.uint32],
) -> int:
    """Write the triangles of all faces. Returns how many there are."""
    at = 0
    for place in range(faces.size):
        face = faces[place]
        for j in range(cases.shape[1]):
            for i in range(cases.shape[2]):
                case = np.int64(cases[place, j, i])
                for loop in range(np.int64(case_firsts[case]), np.int64(case_firsts[case + 1])):
                    number = np.int64(case_loops[loop])
                    for row in range(np.int64(loop_firsts[number]), np.int64(loop_firsts[number + 1])):
                        for corner in range(3):
                            edge = int(np.int64(loop_triangles[row, corner]))
                            triangles[at, corner] = _vertex(face, edge, i, j, numbers, edges, firsts)
                        at += has_three_places(positions, triangles[at])
    return at


@inlined
def _vertex(face: _Face, edge: int, i: int, j: int, numbers: NDArray[np.int32], edges: _Words, firsts: _Numbers) -> int:
    """Return the vertex on an edge of the transition cell at coarse corner (i, j)."""
    kind, u, v = _EDGES[edge, 0], _EDGES[edge, 2], _EDGES[edge, 3]
    axis = face.u if kind == 0 else face.v if kind == 1 else _TWIN
    if kind == 2 or _EDGES[edge, 1]:
        place = face.number_start + (i + (u >> 1)) * face.number_u + (j + (v >> 1)) * face.number_v
        return int(np.int64(numbers[axis, place]))
    p, q = 2 * i + u, 2 * j + v
    x = p if face.u == 0 else q if face.v == 0 else face.far
    y = p if face.u == 1 else q if face.v == 1 else face.far
    z = p if face.u == 2 else q if face.v == 2 else face.far
    return int(firsts[y, z, axis, x >> 6] + popcount(edges[y, z, axis, x >> 6] & below(x & 63)))
