"""Marching cubes on the vertex lattice: indexed, one vertex per crossed edge, no vertex on a corner.

Works on rows along x, as bits. A row of corners is a word of inside flags; a row of edges is the exclusive or of two
such words, so an empty row costs a few instructions for all its cells:

    corners  (y, z)      0 0 1 1 1 0 ...     inside flags
    corners  (y, z+1)    0 1 1 1 0 0 ...
    z edges  (y, z)      0 1 0 0 1 0 ...     crossed edges: a vertex each
    x edges  (y, z)      0 1 0 0 1 ...       a row against itself, one place on

Vertices are numbered row by row and axis by axis along the set bits. So a vertex is found again without any index
buffer: the number of its row's first vertex, plus the count of set bits below it. `_count` fills in the rows and how
many vertices and triangles there are, so that all arrays are exactly as long as needed; `_fill` writes them.

Source: W. Lorensen and H. Cline, "Marching Cubes" (1987). The cases are our own derivation (`cases.py`).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_LOW
from chunkserver.kernel import inlined, kernel
from chunkserver.mesh import EMPTY, POSITION_W, Mesh, NormalKind
from chunkserver.mesher.bits import WORD_BITS, below, first_places, lowest, popcount, without_lowest, words_for
from chunkserver.mesher.cases import CUBE_COUNTS, CUBE_EDGES
from chunkserver.mesher.cell import CUBE
from chunkserver.mesher.crossing import crossing, is_rock
from chunkserver.mesher.normals import edge_normal, store_normal
from chunkserver.mesher.transitions import NO_SEAMS, count_seams, fill_seams
from chunkserver.samples import Samples

APRON: Final = 1
"""Samples around the corners: central differences at the border read one."""

EDGE_LOWS: Final = np.array([CUBE.corners[low] for low, _ in CUBE.edges], np.int64)
"""Where each edge of a cell starts, in cell units from the cell's low corner: (12, 3), x y z."""

_Densities = NDArray[np.float32]
_Words = NDArray[np.uint64]
_Numbers = NDArray[np.int64]


def marching_cubes(samples: Samples, normals: NormalKind) -> Mesh:
    """Return the marching cubes mesh of one chunk.

    Vertices are exact on their edge's lattice: the crossing is rounded to the lattice unit and kept off both corners.
    No triangle has two equal corners or no area; the mesh of any set of chunks of one level is closed but for the set's
    own border (`tests/property/test_closed.py`). Normals are within rounding of the interpolated central differences.
    """
    shape = samples.shape
    corners, words = shape.corners, words_for(shape.corners)
    rows = np.empty((corners, corners, words), np.uint64)
    edges = np.empty((corners, corners, 3, words), np.uint64)
    firsts = np.empty((corners, corners, 3, words), np.int64)
    vertices, triangles = _count(samples.density, shape.apron, rows, edges, firsts)
    seams = count_seams(samples, vertices) if samples.coarser else NO_SEAMS
    every = vertices + len(seams.vertices)
    if every == 0:
        return EMPTY["rock" if rows[0, 0, 0] & np.uint64(1) else "air"]
    positions = np.empty((every, 4), np.uint16)
    as_int8 = np.empty((every if normals == "int8" else 0, 4), np.int8)
    as_float32 = np.empty((every if normals == "float32" else 0, 3), np.float32)
    indices = np.empty((triangles + seams.triangles, 3), np.uint32)
    flat = samples.density.reshape(-1)
    _fill_vertices(flat, shape.samples, shape.apron, shape.units_per_cell, edges, positions, as_int8, as_float32)
    _fill_triangles(rows, edges.reshape(-1), firsts.reshape(-1), indices)
    if samples.coarser:
        regular, more = indices[:triangles], indices[triangles:]
        triangles += fill_seams(samples, seams, edges, firsts, positions, as_int8, as_float32, regular, more)
    return Mesh("surface", positions, as_int8 if normals == "int8" else as_float32, indices[:triangles])


@kernel
def _count(density: _Densities, apron: int, rows: _Words, edges: _Words, firsts: _Numbers) -> tuple[int, int]:
    """Fill in the rows of corners and edges, and the number of each row's first vertex.

    density: (n, n, n), apron included. rows: (y, z, word) out, inside flags. edges: (y, z, axis, word) out, crossed
    edges by the corner that they start at. firsts: (y, z, axis, word) out.
    Returns the number of vertices and of triangles.
    """
    corners = rows.shape[0]
    for y in range(corners):
        for z in range(corners):
            _pack(density[y + apron, z + apron, apron : apron + corners], rows[y, z])
    vertices = _number_vertices(rows, edges, firsts)
    triangles = 0
    if vertices > 0:
        for y in range(corners - 1):
            for z in range(corners - 1):
                triangles += _count_triangles(rows, y, z)
    return vertices, triangles


@kernel
def _pack(densities: _Densities, row: _Words) -> None:
    """Set the inside flags of one row of corners."""
    for word in range(row.size):
        start = word * WORD_BITS
        flags = np.uint64(0)
        for place in range(min(WORD_BITS, densities.size - start)):
            flags |= np.uint64(is_rock(densities[start + place])) << np.uint64(place)
        row[word] = flags


@inlined
def _one_on(row: _Words, word: int) -> np.uint64:
    """Return word number `word` of a row, each place showing the flag of the next place."""
    follows = row[word + 1] << np.uint64(63) if word + 1 < row.size else np.uint64(0)
    return np.uint64(row[word] >> np.uint64(1) | follows)


@kernel
def _number_vertices(rows: _Words, edges: _Words, firsts: _Numbers) -> int:
    """Fill in the crossed edges of every row and the number of its first vertex. Returns how many there are."""
    corners, _, words = rows.shape
    last, vertices = corners - 1, 0
    for y in range(corners):
        for z in range(corners):
            row = rows[y, z]
            for axis in range(3):
                for word in range(words):
                    crossed = np.uint64(0)
                    if axis == 0:
                        crossed = (row[word] ^ _one_on(row, word)) & first_places(last, word)
                    elif axis == 1 and y < last:
                        crossed = row[word] ^ rows[y + 1, z, word]
                    elif axis == 2 and z < last:
                        crossed = row[word] ^ rows[y, z + 1, word]
                    edges[y, z, axis, word] = crossed
                    firsts[y, z, axis, word] = vertices
                    vertices += popcount(crossed)
    return vertices


@inlined
def _corner_words(rows: _Words, y: int, z: int, word: int) -> tuple[np.uint64, ...]:
    """Return the inside flags of a row of cells, one word for each of a cell's eight corners, in corner order."""
    a, b, c, d = rows[y, z], rows[y + 1, z], rows[y, z + 1], rows[y + 1, z + 1]
    return (
        a[word],
        _one_on(a, word),
        b[word],
        _one_on(b, word),
        c[word],
        _one_on(c, word),
        d[word],
        _one_on(d, word),
    )


@inlined
def _mixed_cells(corner: tuple[np.uint64, ...], cells: int, word: int) -> np.uint64:
    """Return which cells of a row have corners on both sides of the surface."""
    some = corner[0] | corner[1] | corner[2] | corner[3] | corner[4] | corner[5] | corner[6] | corner[7]
    every = corner[0] & corner[1] & corner[2] & corner[3] & corner[4] & corner[5] & corner[6] & corner[7]
    return some & ~every & first_places(cells, word)


@inlined
def _case(corner: tuple[np.uint64, ...], place: int) -> int:
    """Return the case of one cell of a row: bit c is set if corner c is inside."""
    case = np.uint64(0)
    for number in range(8):
        case |= (corner[number] >> np.uint64(place) & np.uint64(1)) << np.uint64(number)
    return int(np.int64(case))


@kernel
def _count_triangles(rows: _Words, y: int, z: int) -> int:
    """Return how many triangles a row of cells holds."""
    triangles = 0
    for word in range(rows.shape[2]):
        corner = _corner_words(rows, y, z, word)
        left = _mixed_cells(corner, rows.shape[0] - 1, word)
        while left:
            triangles += CUBE_COUNTS[_case(corner, lowest(left))]
            left = without_lowest(left)
    return triangles


@kernel
def _fill_vertices(
    density: _Densities,
    side: int,
    apron: int,
    units: int,
    edges: _Words,
    positions: NDArray[np.uint16],
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
) -> None:
    """Write position and normal of every vertex, in the order in which `_number_vertices` counted them.

    density: flat, `side` samples a side. A flat index and three strides: one address a sample, not three products.
    """
    corners, _, _, words = edges.shape
    plane, cells_per_unit = side * side, 1.0 / units
    vertex = 0
    for y in range(corners):
        for z in range(corners):
            start = (y + apron) * plane + (z + apron) * side + apron
            for axis in range(3):
                along = 1 if axis == 0 else plane if axis == 1 else side
                for word in range(words):
                    left = edges[y, z, axis, word]
                    while left:
                        x = word * WORD_BITS + lowest(left)
                        left = without_lowest(left)
                        low, high = start + x, start + x + along
                        units_on = crossing(density[low], density[high], units)
                        positions[vertex, 0] = POSITION_LOW + units * x + (units_on if axis == 0 else 0)
                        positions[vertex, 1] = POSITION_LOW + units * y + (units_on if axis == 1 else 0)
                        positions[vertex, 2] = POSITION_LOW + units * z + (units_on if axis == 2 else 0)
                        positions[vertex, 3] = POSITION_W
                        normal = edge_normal(density, low, high, side, plane, units_on * cells_per_unit)
                        store_normal(normal, vertex, as_int8, as_float32)
                        vertex += 1


@kernel
def _fill_triangles(rows: _Words, edges: _Words, firsts: _Numbers, triangles: NDArray[np.uint32]) -> None:
    """Write the triangles of every cell. edges, firsts: as `_count` fills them in, flat."""
    corners, _, words = rows.shape
    row, plane = 3 * words, 3 * words * corners
    # Where the words of each edge of a cell lie, from those of the cell's low corner.
    rows_on = np.empty(12, np.int64)
    for edge in range(12):
        rows_on[edge] = EDGE_LOWS[edge, 1] * plane + EDGE_LOWS[edge, 2] * row + (edge >> 2) * words
    at = 0
    for y in range(corners - 1):
        for z in range(corners - 1):
            for word in range(words):
                corner = _corner_words(rows, y, z, word)
                left = _mixed_cells(corner, corners - 1, word)
                while left:
                    place = lowest(left)
                    left = without_lowest(left)
                    case = _case(corner, place)
                    for triangle in range(CUBE_COUNTS[case]):
                        for vertex in range(3):
                            edge = CUBE_EDGES[case, 3 * triangle + vertex]
                            x = word * WORD_BITS + place + EDGE_LOWS[edge, 0]
                            of_row = y * plane + z * row + rows_on[edge] + (x >> 6)
                            triangles[at, vertex] = firsts[of_row] + popcount(edges[of_row] & below(x & 63))
                        at += 1
