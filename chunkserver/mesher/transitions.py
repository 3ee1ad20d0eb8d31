r"""The border to a coarser chunk, closed in the finer one: its outer layer of cells makes room for transition cells.

    coarser chunk |    this chunk: d < 1 cell becomes a quarter .. 1
                  |
        o---------+--+-o---o-     +  coarse corners, sampled from the next level's field, as the coarser chunk does
        |         |\ | |   |      o  corners of this chunk's cells
        |         | \o-o---o-
        |         |  | |   |      between the border and what made room: a transition cell for each face of a
        |         | /o-o---o-     coarse cell, 13 signs, `TRANSITION` in cell.py. Its fine side has the vertices of the
        |         |/ | |   |      regular mesh, its coarse side those that the coarser chunk has there.
        o---------+--+-o---o-

Not every vertex may move (`room.py`): where one does not, transition cells are flat, and triangles with two equal
corners are left out.

The levels are sampled from different fields, so a fine corner and its coarse twin may differ in sign. That edge, too,
then has a vertex: between where the two corners are.
"""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_LOW
from chunkserver.kernel import inlined, kept, kernel
from chunkserver.mesh import POSITION_W
from chunkserver.mesher.bits import ONE, below, popcount
from chunkserver.mesher.cases import LoopTable, loop_table
from chunkserver.mesher.cell import TRANSITION
from chunkserver.mesher.crossing import crossing, is_rock
from chunkserver.mesher.faces import Face, Walk, corner_at, face_at, masked_faces
from chunkserver.mesher.normals import edge_normal, store_normal, twin_normal
from chunkserver.mesher.room import make_room, room
from chunkserver.mesher.rows import RUN_CELLS
from chunkserver.mesher.triangles import has_three_places
from chunkserver.samples import Samples, coarse_box

_TWIN: Final = 3
"""The kind of an edge between a fine corner and its coarse twin; 0, 1, 2 are coarse edges along x, y, z."""

_Densities = NDArray[np.float32]
_Words = NDArray[np.uint64]
_Places = NDArray[np.uint16]
_Numbers = NDArray[np.int64]
_Signs = NDArray[np.uint8]


def _edge_rows() -> _Numbers:
    """Return, for each edge of the transition cell: along u (0), along v (1) or a twin (2); coarse or not; u; v."""
    rows = []
    for low, high in TRANSITION.edges:
        (u, v, w), (s, t, r) = TRANSITION.corners[low], TRANSITION.corners[high]
        rows.append((2 if w != r else int(u == s), int(w == r == 0), min(u, s), min(v, t)))
    return np.array(rows, np.int64)


_EDGES: Final = _edge_rows()

TWIN_SHARE: Final = 1 / 16
"""How much of the room a vertex between a corner and its twin takes: less than what is beside it, which may have made
less room than it should. With half of it, up to 0.3 % of the rays at borders met the back of a triangle first."""


@cache
def _table() -> LoopTable:
    """Return the cases of the transition cell: worked out once, and kept beside the compiled code."""
    return LoopTable(*kept("transition-cases", lambda: loop_table(TRANSITION)))


class Seams(NamedTuple):
    """What transition cells add to the regular mesh.

    faces: (masked faces, 13) int64, the numbers of a `Face`. coarse: the coarse samples, flat.
    numbers: (4, n * n * n) int32, C order, kind and x, y, z in coarse corners: the vertex on the coarse edge along x, y
        or z that starts there, or between that corner and its fine twin; -1 for none.
    vertices: (V, 4) int32, new ones: face, kind, u and v in coarse corners.
    cells: (C, 4) int32, those that hold triangles: face, case, u and v. triangles: how many they hold.
    """

    faces: _Numbers
    coarse: _Densities
    numbers: NDArray[np.int32]
    vertices: NDArray[np.int32]
    cells: NDArray[np.int32]
    triangles: int


NO_SEAMS: Final = Seams(
    faces=np.empty((0, 13), np.int64),
    coarse=np.empty(0, np.float32),
    numbers=np.empty((4, 0), np.int32),
    vertices=np.empty((0, 4), np.int32),
    cells=np.empty((0, 4), np.int32),
    triangles=0,
)
"""Of a chunk whose neighbours are all of its own level."""


def count_seams(samples: Samples, first: int) -> Seams:
    """Number the vertices of all transition cells, from `first` on, and find the cells that hold triangles."""
    assert samples.coarse is not None, "coarse samples come with every mask"
    corners = samples.shape.cells // 2 + 1
    faces, coarse = masked_faces(samples.shape.cells, samples.shape.apron, samples.coarser), samples.coarse.reshape(-1)
    numbers = np.full((4, corners**3), -1, np.int32)
    vertices = np.empty((3 * len(faces) * corners**2, 4), np.int32)
    cells = np.empty((len(faces) * (corners - 1) ** 2, 4), np.int32)
    fine = samples.density.reshape(-1)
    made, filled, triangles = _count(faces, corners, fine, coarse, first, numbers, vertices, cells, _table().counts)
    return Seams(faces, coarse, numbers, vertices[:made], cells[:filled], triangles)


def fill_seams(
    samples: Samples,
    seams: Seams,
    rows: _Words,
    firsts: _Words,
    positions: _Places,
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
    regular: NDArray[np.uint32],
) -> NDArray[np.uint32]:
    """Make room in the regular mesh, and write what was counted. Return its triangles and then those of the seams.

    rows, firsts: of the regular mesh, see `rows.py`. positions: (V, 4), its vertices first. regular: its triangles.
    Triangles of the seams with two equal corners are left out.
    """
    shape, mask = samples.shape, samples.coarser
    make_room(samples, positions[: len(positions) - len(seams.vertices)], regular)
    _, planes, width = coarse_box(shape.cells, mask).shape
    _fill_vertices(
        seams.faces,
        seams.vertices,
        samples.density.reshape(-1),
        shape.samples,
        seams.coarse,
        width,
        width * planes,
        mask,
        shape.units_per_cell,
        positions,
        as_int8,
        as_float32,
    )
    triangles = np.empty((len(regular) + seams.triangles, 3), np.uint32)
    triangles[: len(regular)] = regular
    more = triangles[len(regular) :]
    used = _fill_triangles(seams.faces, seams.cells, seams.numbers, rows, firsts, positions, *_table()[1:], more)
    return triangles[: len(regular) + used]


@kernel
def _count(
    faces: _Numbers,
    corners: int,
    fine: _Densities,
    coarse: _Densities,
    first: int,
    numbers: NDArray[np.int32],
    vertices: NDArray[np.int32],
    cells: NDArray[np.int32],
    triangles_of: NDArray[np.uint8],
) -> tuple[int, int, int]:
    """Fill in `numbers`, `vertices` and `cells` as `Seams` has them. Returns how many of both, and of triangles.

    corners: coarse ones a side. A face that the surface does not meet is looked at and left.
    """
    fine_rock = np.empty((2 * corners - 1, 2 * corners - 1), np.uint8)
    coarse_rock = np.empty((corners, corners), np.uint8)
    made = filled = triangles = 0
    for place in range(faces.shape[0]):
        face = face_at(faces, place)
        halved = Walk(face.fine.start, face.fine.u // 2, face.fine.v // 2)
        rocks = _look(fine, halved, fine_rock) + _look(coarse, face.coarse, coarse_rock)
        if 0 < rocks < fine_rock.size + coarse_rock.size:
            made = _number(face, place, fine_rock, coarse_rock, first, numbers, vertices, made)
            filled, more = _classify(place, fine_rock, coarse_rock, triangles_of, cells, filled)
            triangles += more
    return made, filled, triangles


@inlined
def _look(densities: _Densities, walk: Walk, rock: _Signs) -> int:
    """Write which samples on a face are inside, v slow and u fast. Returns how many are."""
    count = 0
    for j in range(rock.shape[0]):
        for i in range(rock.shape[1]):
            rock[j, i] = is_rock(densities[corner_at(walk, i, j)])
            count += rock[j, i]
    return count


@inlined
def _number(
    face: Face,
    place: int,
    fine_rock: _Signs,
    coarse_rock: _Signs,
    first: int,
    numbers: NDArray[np.int32],
    vertices: NDArray[np.int32],
    made: int,
) -> int:
    """Number the vertices of a face, but for those that another face has already. Returns how many there are now."""
    last = coarse_rock.shape[0] - 1
    for j in range(last + 1):
        for i in range(last + 1):
            here = coarse_rock[j, i]
            crossed = (
                i < last and coarse_rock[j, min(i + 1, last)] != here,
                j < last and coarse_rock[min(j + 1, last), i] != here,
                fine_rock[2 * j, 2 * i] != here,
            )
            kinds, number = (face.u, face.v, _TWIN), corner_at(face.number, i, j)
            for turn in range(3):
                kind = kinds[turn]
                if crossed[turn] and numbers[kind, number] < 0:
                    numbers[kind, number] = first + made
                    vertices[made, 0], vertices[made, 1], vertices[made, 2], vertices[made, 3] = place, kind, i, j
                    made += 1
    return made


@inlined
def _classify(
    place: int,
    fine_rock: _Signs,
    coarse_rock: _Signs,
    triangles_of: NDArray[np.uint8],
    cells: NDArray[np.int32],
    filled: int,
) -> tuple[int, int]:
    """List the cells of a face that hold triangles. Returns how many are listed now, and the triangles of these."""
    triangles, last = 0, coarse_rock.shape[0] - 1
    for j in range(last):
        for i in range(last):
            case = 0
            for corner in range(9):
                case |= int(fine_rock[2 * j + corner // 3, 2 * i + corner % 3]) << corner
            for corner in range(4):
                case |= int(coarse_rock[j + corner // 2, i + corner % 2]) << 9 + corner
            if triangles_of[case]:
                cells[filled, 0], cells[filled, 1], cells[filled, 2], cells[filled, 3] = place, case, i, j
                filled += 1
                triangles += int(np.int64(triangles_of[case]))
    return filled, triangles


@kernel
def _fill_vertices(
    faces: _Numbers,
    vertices: NDArray[np.int32],
    fine: _Densities,
    side: int,
    coarse: _Densities,
    row: int,
    plane: int,
    mask: int,
    units: int,
    positions: _Places,
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
) -> None:
    """Write position and normal of the new vertices, which are the last ones of `positions`.

    side: fine samples a side. row, plane: how far apart coarse samples are in z and in y.
    """
    for made in range(vertices.shape[0]):
        vertex = positions.shape[0] - vertices.shape[0] + made
        face = face_at(faces, vertices[made, 0])
        kind, i, j = int(vertices[made, 1]), int(vertices[made, 2]), int(vertices[made, 3])
        at = corner_at(face.coarse, i, j)
        _put(face, i, j, units, positions, vertex)
        if kind == _TWIN:
            _put_between(mask, units, positions, vertex)
            normal = twin_normal(fine, corner_at(face.fine, i, j), side, side * side, coarse, at, row, plane)
        else:
            next_at = at + (face.coarse.u if kind == face.u else face.coarse.v)
            units_on = crossing(coarse[at], coarse[next_at], units)
            positions[vertex, kind] += 2 * units_on
            normal = edge_normal(coarse, at, next_at, row, plane, units_on * (1.0 / units))
        store_normal(normal, vertex, as_int8, as_float32)


@inlined
def _put(face: Face, i: int, j: int, units: int, positions: _Places, vertex: int) -> None:
    """Write the position of coarse corner (i, j) of a face."""
    positions[vertex, face.u] = POSITION_LOW + 2 * units * i
    positions[vertex, face.v] = POSITION_LOW + 2 * units * j
    positions[vertex, face.w] = POSITION_LOW + units * face.far
    positions[vertex, 3] = POSITION_W


@inlined
def _put_between(mask: int, units: int, positions: _Places, vertex: int) -> None:
    """Move a coarse corner a part of the way to its fine twin, which makes room."""
    x, y, z = room(positions, vertex, mask, units)
    positions[vertex, 0] += np.int64(TWIN_SHARE * x)
    positions[vertex, 1] += np.int64(TWIN_SHARE * y)
    positions[vertex, 2] += np.int64(TWIN_SHARE * z)


@kernel
def _fill_triangles(
    faces: _Numbers,
    cells: NDArray[np.int32],
    numbers: NDArray[np.int32],
    rows: _Words,
    firsts: _Words,
    positions: _Places,
    case_firsts: NDArray[np.uint16],
    case_loops: NDArray[np.uint16],
    loop_firsts: NDArray[np.uint16],
    loop_triangles: NDArray[np.uint8],
    triangles: NDArray[np.uint32],
) -> int:
    """Write the triangles of all cells. Returns how many there are."""
    at = 0
    for cell in range(cells.shape[0]):
        face = face_at(faces, cells[cell, 0])
        case, i, j = cells[cell, 1], int(cells[cell, 2]), int(cells[cell, 3])
        for loop in range(np.int64(case_firsts[case]), np.int64(case_firsts[case + 1])):
            number = np.int64(case_loops[loop])
            for row in range(np.int64(loop_firsts[number]), np.int64(loop_firsts[number + 1])):
                for corner in range(3):
                    edge = int(np.int64(loop_triangles[row, corner]))
                    triangles[at, corner] = _vertex(face, edge, i, j, numbers, rows, firsts)
                at += has_three_places(positions, triangles, at)
    return at


@inlined
def _vertex(face: Face, edge: int, i: int, j: int, numbers: NDArray[np.int32], rows: _Words, firsts: _Words) -> int:
    """Return the vertex on an edge of the transition cell at coarse corner (i, j)."""
    kind, u, v = _EDGES[edge, 0], _EDGES[edge, 2], _EDGES[edge, 3]
    axis = face.u if kind == 0 else face.v if kind == 1 else _TWIN
    if kind == 2 or _EDGES[edge, 1]:
        return int(np.int64(numbers[axis, corner_at(face.number, i + (u >> 1), j + (v >> 1))]))
    p, q = 2 * i + u, 2 * j + v
    x = p if face.u == 0 else q if face.v == 0 else face.far
    y = p if face.u == 1 else q if face.v == 1 else face.far
    z = p if face.u == 2 else q if face.v == 2 else face.far
    run = min(x // RUN_CELLS, rows.shape[2] - 1)
    here = rows[y, z, run]
    after = here >> ONE if axis == 0 else rows[y + (axis == 1), z + (axis == 2), run]
    before = (here ^ after) & below(np.uint64(x - run * RUN_CELLS))
    return int(np.int64(firsts[y, z, run, axis] + popcount(before)))
