"""Marching cubes on the vertex lattice: indexed, one vertex per crossed edge, no vertex on a corner.

Two passes. `_count` finds each cell's case and how many vertices and triangles there will be, so that the arrays are
exactly as long as needed. `_fill` walks the horizontal planes upwards. It writes the vertices on the edges that start
at each corner of a plane, remembers their indices for two planes only, then the triangles of the layer below it:

    plane y+1  +---e---+---e---+     vertices of this plane (x and z edges): just written
               |       |       |
               e       e       e     vertices of the layer (y edges): written with plane y
               |       |       |
    plane y    +---e---+---e---+     vertices of this plane: written a step ago

Source: W. Lorensen and H. Cline, "Marching Cubes" (1987); the cases are our own derivation (`cases.py`).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_LOW
from chunkserver.kernel import kernel
from chunkserver.mesh import EMPTY, POSITION_W, Mesh, NormalKind
from chunkserver.mesher.cases import CUBE_COUNTS, CUBE_EDGES
from chunkserver.mesher.normals import edge_normal, store_normal
from chunkserver.samples import Samples

APRON: Final = 1
"""Samples around the corners: central differences at the border read one."""

ISOVALUE: Final = np.float32(0)
"""Below is rock; exactly at it, or above, is air. `_is_inside` is the only comparison."""

EDGE_PLACES: Final = np.array([(e >> 2, e & 1, e >> 1 & 1) for e in range(12)], np.int64)
"""For each edge of a cell: axis, and offsets along the two other axes, lower axis first."""

_Densities = NDArray[np.float32]
_Bytes = NDArray[np.uint8]
_Counts = NDArray[np.int64]


def marching_cubes(samples: Samples, normals: NormalKind) -> Mesh:
    """Return the marching cubes mesh of one chunk.

    Vertices are exact on their edge's lattice: the crossing is rounded to the lattice unit and kept off both corners.
    No triangle has two equal corners or no area; the mesh of any set of chunks of one level is closed but for the set's
    own border (`tests/property/test_closed.py`). Normals are within rounding of the interpolated central differences.
    """
    shape = samples.shape
    inside = np.empty((shape.corners,) * 3, np.uint8)
    cases = np.empty((shape.cells,) * 3, np.uint8)
    crossings = np.empty((shape.corners, shape.corners), np.int64)
    vertices, triangles, inside_count = _count(samples.density, shape.apron, inside, cases, crossings)
    if vertices == 0:
        return EMPTY["rock" if inside_count else "air"]
    positions = np.empty((vertices, 4), np.uint16)
    as_int8 = np.empty((vertices if normals == "int8" else 0, 4), np.int8)
    as_float32 = np.empty((vertices if normals == "float32" else 0, 3), np.float32)
    corners_of = np.empty((triangles, 3), np.uint32)
    _fill(
        samples.density,
        shape.apron,
        shape.units_per_cell,
        inside,
        cases,
        crossings,
        np.empty((2, 3, shape.corners, shape.corners), np.uint32),
        positions,
        as_int8,
        as_float32,
        corners_of,
    )
    return Mesh("surface", positions, as_int8 if normals == "int8" else as_float32, corners_of)


@kernel
def _count(density: _Densities, apron: int, inside: _Bytes, cases: _Bytes, crossings: _Counts) -> tuple[int, int, int]:
    """Fill in which corners are inside, each cell's case, and the crossed edges that start at each row of corners.

    density: (n, n, n), apron included. inside: (corners,)*3 out. cases: (cells,)*3 out. crossings: (y, z) out.
    Returns the number of vertices, of triangles and of inside corners.
    """
    corners = inside.shape[0]
    inside_count = 0
    for y in range(corners):
        for z in range(corners):
            row, flags = density[y + apron, z + apron, apron : apron + corners], inside[y, z]
            for x in range(corners):
                flags[x] = np.uint8(row[x] < ISOVALUE)
            inside_count += flags.sum()
    vertices, triangles = 0, 0
    if 0 < inside_count < corners**3:
        for y in range(corners):
            for z in range(corners):
                crossings[y, z] = _count_crossings(inside, y, z)
                vertices += crossings[y, z]
        for y in range(corners - 1):
            for z in range(corners - 1):
                triangles += _count_triangles(inside, y, z, cases[y, z])
    return vertices, triangles, inside_count


@kernel
def _count_crossings(inside: _Bytes, y: int, z: int) -> int:
    """Return how many crossed edges start at the corners of row (y, z)."""
    row, last = inside[y, z], inside.shape[0] - 1
    crossed = 0
    for x in range(last):
        crossed += row[x] ^ row[x + 1]
    if y < last:
        above = inside[y + 1, z]
        for x in range(last + 1):
            crossed += row[x] ^ above[x]
    if z < last:
        beside = inside[y, z + 1]
        for x in range(last + 1):
            crossed += row[x] ^ beside[x]
    return crossed


@kernel
def _count_triangles(inside: _Bytes, y: int, z: int, cases: _Bytes) -> int:
    """Fill in the cases of one row of cells and return how many triangles they hold."""
    a, b, c, d = inside[y, z], inside[y + 1, z], inside[y, z + 1], inside[y + 1, z + 1]
    all_inside, none_inside = np.uint8(255), np.uint8(0)
    for x in range(cases.size):
        low = a[x] | a[x + 1] << 1 | b[x] << 2 | b[x + 1] << 3
        high = c[x] | c[x + 1] << 1 | d[x] << 2 | d[x + 1] << 3
        case = np.uint8(low | high << 4)
        cases[x] = case
        all_inside &= case
        none_inside |= case
    triangles = 0
    if all_inside != 255 and none_inside != 0:
        for x in range(cases.size):
            triangles += CUBE_COUNTS[cases[x]]
    return triangles


@kernel
def _fill(
    density: _Densities,
    apron: int,
    units: int,
    inside: _Bytes,
    cases: _Bytes,
    crossings: _Counts,
    indices: NDArray[np.uint32],
    positions: NDArray[np.uint16],
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
    triangles: NDArray[np.uint32],
) -> None:
    """Write every vertex and triangle. `indices`: (2, 3, corners, corners) scratch, by parity of y, axis, z, x."""
    corners = inside.shape[0]
    vertex, triangle = 0, 0
    for y in range(corners):
        for z in range(corners):
            if crossings[y, z] > 0:
                vertex = _fill_vertices(
                    density, apron, units, inside, y, z, indices[y & 1], vertex, positions, as_int8, as_float32
                )
        if y > 0:
            triangle = _fill_triangles(cases[y - 1], y - 1, indices, triangle, triangles)


@kernel
def _fill_vertices(
    density: _Densities,
    apron: int,
    units: int,
    inside: _Bytes,
    y: int,
    z: int,
    indices: NDArray[np.uint32],
    vertex: int,
    positions: NDArray[np.uint16],
    as_int8: NDArray[np.int8],
    as_float32: NDArray[np.float32],
) -> int:
    """Write the vertices on the edges that start at the corners of row (y, z). Returns the next vertex."""
    last = inside.shape[0] - 1
    for x in range(last + 1):
        here = inside[y, z, x]
        for axis in range(3):
            x1, y1, z1 = x + (axis == 0), y + (axis == 1), z + (axis == 2)
            if x1 > last or y1 > last or z1 > last or inside[y1, z1, x1] == here:
                continue
            at_y, at_z, at_x = y + apron, z + apron, x + apron
            crossing = _crossing(density[at_y, at_z, at_x], density[y1 + apron, z1 + apron, x1 + apron], units)
            positions[vertex, 0] = POSITION_LOW + units * x + crossing * (axis == 0)
            positions[vertex, 1] = POSITION_LOW + units * y + crossing * (axis == 1)
            positions[vertex, 2] = POSITION_LOW + units * z + crossing * (axis == 2)
            positions[vertex, 3] = POSITION_W
            normal = edge_normal(density, at_y, at_z, at_x, axis, crossing / units)
            store_normal(normal, vertex, as_int8, as_float32)
            indices[axis, z, x] = vertex
            vertex += 1
    return vertex


@kernel
def _crossing(low: np.float32, high: np.float32, units: int) -> int:
    """Return where the density crosses the isovalue between two corners, in lattice units, off both corners."""
    a, b = np.float64(low), np.float64(high)
    nearest = int(np.floor((np.float64(ISOVALUE) - a) / (b - a) * units + 0.5))
    return min(max(nearest, 1), units - 1)


@kernel
def _fill_triangles(
    cases: _Bytes, y: int, indices: NDArray[np.uint32], triangle: int, triangles: NDArray[np.uint32]
) -> int:
    """Write the triangles of one layer of cells. Returns the next triangle."""
    cells = cases.shape[0]
    for z in range(cells):
        for x in range(cells):
            case = cases[z, x]
            for corner in range(3 * CUBE_COUNTS[case]):
                axis, first, second = EDGE_PLACES[CUBE_EDGES[case, corner]]
                if axis == 0:
                    index = indices[(y + first) & 1, 0, z + second, x]
                elif axis == 1:
                    index = indices[y & 1, 1, z + second, x + first]
                else:
                    index = indices[(y + second) & 1, 2, z, x + first]
                triangles[triangle + corner // 3, corner % 3] = index
            triangle += CUBE_COUNTS[case]
    return triangle
