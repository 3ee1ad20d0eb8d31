"""Marching cubes on the vertex lattice: indexed, one vertex per crossed edge, no vertex on a corner.

Rows along x are words of bits (`rows.py`), so that what the surface does not meet costs a few instructions a row:

    pack      the inside flags of all corners, 32 at a time
    list      the runs of crossed edges and of mixed cells; how many vertices and mixed cells that is
    connect   plane by plane: number the vertices, in the order of the list, and write the triangles of the cells below
    fill      position and normal of each vertex (`vertices.py`)

A vertex is found again without any index buffer of the whole chunk: cells between two planes of corners have vertices
on these and between them, so the numbers of two planes are enough.

Source: W. Lorensen and H. Cline, "Marching Cubes" (1987). The cases are our own derivation (`cases.py`).
"""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import ChunkShape
from chunkserver.kernel import inlined, kernel, uncounted
from chunkserver.mesh import EMPTY, Mesh, NormalKind, as_indices, index_type
from chunkserver.mesher.bits import ONE, below, lowest, without_lowest
from chunkserver.mesher.cases import CUBE_COUNTS, CUBE_EDGES, CUBE_TRIANGLES_MAX
from chunkserver.mesher.cell import CUBE
from chunkserver.mesher.rows import (
    ALL_ROCK,
    FLAGS,
    MIXED,
    RUN_BITS,
    RUN_CELLS,
    SLOT_X,
    Words,
    list_runs,
    pack,
    runs_of,
    slot_bits,
)
from chunkserver.mesher.transitions import NO_SEAMS, count_seams, fill_seams
from chunkserver.mesher.vertices import fill_vertices
from chunkserver.samples import Samples

APRON: Final = 1
"""Samples around the corners: central differences at the border read one."""

INDICES_MAX: Final = 3 * CUBE_TRIANGLES_MAX
"""Of one cell."""
INDICES_MOST: Final = 9
"""So many are always written, whatever the case: cheaper than to ask each time. Few cells have more."""

_NO_FIRSTS: Final = np.empty(0, np.uint64)
_NO_INT8: Final = np.empty(0, np.uint32)
_NO_FLOAT32: Final = np.empty(0, np.float32)

_Slots = NDArray[np.uint32]
_Indices = NDArray[np.uint16] | NDArray[np.uint32]


def marching_cubes(samples: Samples, normals: NormalKind) -> Mesh:
    """Return the marching cubes mesh of one chunk.

    Vertices are exact on their edge's lattice: the crossing is rounded to the lattice unit and kept off both corners.
    No triangle has two equal corners or no area; the mesh of any set of chunks of one level is closed but for the set's
    own border (`tests/property/test_closed.py`). Normals are within rounding of the interpolated central differences.
    """
    side, corners, runs, bits, units, strides, offsets = _plan(samples.shape)
    density, apron = samples.density.reshape(-1), samples.shape.apron
    rows = np.empty(corners * corners * runs, np.uint64)
    found = pack(density, side, apron, rows)
    if found != MIXED and not samples.coarser:
        return EMPTY["rock" if found == ALL_ROCK else "air"]
    firsts = np.empty(3 * rows.size, np.uint64) if samples.coarser else _NO_FIRSTS
    edges, cells = np.empty(3 * rows.size + 1, np.uint64), np.empty(rows.size + 1, np.uint64)
    ends = np.empty((corners, 2), np.uint64)
    list_runs(rows, corners, bits, firsts, edges, cells, ends)
    vertices, mixed = ends[-1].tolist()
    seams = count_seams(samples, vertices) if samples.coarser else NO_SEAMS
    every = vertices + len(seams.vertices)
    if every == 0:
        return EMPTY["rock" if found == ALL_ROCK else "air"]
    slots = np.empty(vertices, np.uint32)
    indices = np.empty(INDICES_MAX * (mixed + 1), np.uint32 if samples.coarser else index_type(every))
    indices.resize(_connect(rows, corners, bits, edges, cells, ends, offsets, slots, indices), refcheck=False)
    positions = np.empty(every, np.uint64)
    as_int8 = np.empty(every, np.uint32) if normals == "int8" else _NO_INT8
    as_float32 = np.empty(3 * every, np.float32) if normals == "float32" else _NO_FLOAT32
    fill_vertices(density, strides, apron, units, bits, slots, positions, as_int8, as_float32)
    places, triangles = positions.view(np.uint16).reshape(-1, 4), indices.reshape(-1, 3)
    as_bytes, as_floats = as_int8.view(np.int8).reshape(-1, 4), as_float32.reshape(-1, 3)
    if samples.coarser:
        words = rows.reshape(corners, corners, runs)
        its_firsts = firsts.reshape(*words.shape, 3)
        triangles = fill_seams(samples, seams, words, its_firsts, places, as_bytes, as_floats, triangles)
        triangles = as_indices(triangles, every)
    return Mesh("surface", places, as_bytes if normals == "int8" else as_floats, triangles)


class _Plan(NamedTuple):
    """What a chunk's shape alone says.

    side: samples. corners: a side. runs: of a row. bits: of a slot, for an axis. units: of a cell. strides: (3,), how
    far apart samples are in x, y and z. offsets: `_offsets`.
    """

    side: int
    corners: int
    runs: int
    bits: int
    units: int
    strides: Words
    offsets: NDArray[np.int32]


@cache
def _plan(shape: ChunkShape) -> _Plan:
    side, bits = shape.samples, slot_bits(shape.cells)
    strides = np.array([1, side * side, side], np.uint64)
    return _Plan(side, shape.corners, runs_of(shape.cells), bits, shape.units_per_cell, strides, _offsets(bits))


def _offsets(bits: int) -> NDArray[np.int32]:
    """Return where the numbers of a cell's vertices are, from that of its low corner: (2, 256, 16).

    For cells above even planes and above odd ones, by case; the last is how many indices the case has.
    """
    edges = np.where(CUBE_EDGES == 255, 0, CUBE_EDGES)
    lows = np.array([CUBE.corners[low] for low, _ in CUBE.edges])[edges]
    plane = np.array([1, -1])[:, None, None] << 2 * bits
    places = (lows[..., 1] * plane + (lows[..., 2] << bits) + lows[..., 0] << int(SLOT_X)) + (edges >> 2)
    counts = np.broadcast_to(3 * CUBE_COUNTS[:, None], (2, 256, 1))
    return np.concatenate([places, counts], axis=2).astype(np.int32)


@kernel
def _connect(
    rows: Words,
    corners: int,
    bits: int,
    edges: Words,
    cells: Words,
    ends: Words,
    offsets: NDArray[np.int32],
    slots: _Slots,
    indices: _Indices,
) -> int:
    """Number the vertices and write the triangles. Returns how many indices that are.

    edges, cells, ends: as `list_runs` lists them. offsets: `_offsets`. slots: (V,) out, where each vertex is. indices:
    out, `INDICES_MAX` for each mixed cell, and as much room behind.

    An entry loses its lowest flag at a time. The next one is at hand before it is known whether it is wanted: so there
    is no branch that the machine has to guess.
    """
    offsets, indices = uncounted(offsets), uncounted(indices)
    numbers = np.empty(2 << 2 * bits + int(SLOT_X), indices.dtype)
    ring = below(np.uint64(2 * bits + 1) + SLOT_X)
    vertex, mixed, at = np.uint64(0), np.uint64(0), np.uint64(0)
    edge, next_edge, edges_read = edges[0], edges[1], np.uint64(1)
    cell, next_cell, cells_read = cells[0], cells[1], np.uint64(1)
    plane = np.uint64(rows.size // corners)
    runs = plane // np.uint64(corners)
    for y in range(corners):
        while vertex < ends[y, 0]:
            slot = (edge >> RUN_BITS) + (lowest(edge) << SLOT_X)
            slots[vertex] = slot
            numbers[slot & ring] = vertex
            vertex += ONE
            edge = without_lowest(edge)
            done = edge & FLAGS == np.uint64(0)
            edge = next_edge if done else edge
            edges_read += np.uint64(done)
            next_edge = edges[edges_read]
        while y > 0 and mixed < ends[y - 1, 1]:
            place = lowest(cell)
            slot = (cell >> RUN_BITS) + (place << SLOT_X)
            z = slot >> np.uint64(bits) + SLOT_X & below(np.uint64(bits))
            run = (slot >> SLOT_X & below(np.uint64(bits))) // np.uint64(RUN_CELLS)
            row = np.uint64(y - 1) * plane + z * runs + run
            four = rows[row], rows[row + plane], rows[row + runs], rows[row + plane + runs]
            of_case = offsets[(y - 1) & 1, _case(four, place)]
            here = slot & ring
            for corner in range(INDICES_MOST):
                indices[at + np.uint64(corner)] = numbers[here + np.uint64(of_case[corner])]
            if of_case[INDICES_MAX] > INDICES_MOST:
                for corner in range(INDICES_MOST, INDICES_MAX):
                    indices[at + np.uint64(corner)] = numbers[here + np.uint64(of_case[corner])]
            at += np.uint64(of_case[INDICES_MAX])
            mixed += ONE
            cell = without_lowest(cell)
            done = cell & FLAGS == np.uint64(0)
            cell = next_cell if done else cell
            cells_read += np.uint64(done)
            next_cell = cells[cells_read]
    return int(np.int64(at))


@inlined
def _case(four: tuple[np.uint64, np.uint64, np.uint64, np.uint64], place: np.uint64) -> int:
    """Return the case of a cell, the `place`-th of its run: bit c is set if corner c is inside.

    four: the words of the rows at its edges along x.
    """
    a, b, c, d = four
    pair = np.uint64(3)
    case = a >> place & pair | (b >> place & pair) << np.uint64(2)
    return int(np.int64(case | (c >> place & pair) << np.uint64(4) | (d >> place & pair) << np.uint64(6)))
