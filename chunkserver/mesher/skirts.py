"""Skirts, for clients that cannot name their neighbours' level: the border of a chunk, drawn out into the rock.

        this chunk   face   a neighbour of another level
                       |
     air  -------------o                     What gapes between two borders is a piece of the face, and rock in one of
                       | gap                 the two fields. So each border edge of a chunk gets a quad in the face,
     rock        skirt o-------------        down into the rock as far as there is rock: it covers the gap, and nothing
                       |                     else that can be seen.

An edge of the mesh lies on a face of the chunk exactly if it is on the border: no diagonal lies in a face of a cell
(`cases.py`). A skirt depends on its own chunk alone.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver.kernel import inlined, kernel
from chunkserver.mesh import POSITION_W, Mesh
from chunkserver.mesher.crossing import is_rock
from chunkserver.mesher.normals import edge_normal
from chunkserver.mesher.triangles import has_three_places
from chunkserver.samples import Samples

HEIGHT_CELLS: Final = 6
"""How far a skirt reaches at most: what a neighbour two levels coarser is off by, and less than the margin."""
STEP_CELLS: Final = 0.5
"""How far apart it looks whether there is still rock."""

assert HEIGHT_CELLS < 16 // 2, "a skirt stays within the margin of the smallest chunk"

_Densities = NDArray[np.float32]
_Places = NDArray[np.uint16]
_Numbers = NDArray[np.int64]
_Indices = NDArray[np.uint32]


def with_skirts(mesh: Mesh, samples: Samples) -> Mesh:
    """Return `mesh`, which was extracted from `samples`, with skirts on all six faces of its chunk."""
    lower = np.full((3, len(mesh.positions)), -1, np.int64)
    vertices, edges = _count(mesh.positions, mesh.triangles, lower)
    if not edges:
        return mesh
    positions = np.concatenate([mesh.positions, np.empty((vertices, 4), np.uint16)])
    normals = np.concatenate([mesh.normals, np.empty((vertices, mesh.normals.shape[1]), mesh.normals.dtype)])
    triangles = np.concatenate([mesh.triangles, np.empty((2 * edges, 3), np.uint32)])
    shape = samples.shape
    _draw_out(samples.density.reshape(-1), shape.samples, shape.apron, shape.units_per_cell, lower, positions)
    for of_axis in lower:
        upper = np.flatnonzero(of_axis >= 0)
        normals[of_axis[upper]] = normals[upper]
    return Mesh(mesh.content, positions, normals, triangles[: _fill(positions, lower, len(mesh.triangles), triangles)])


@inlined
def _face_axis(positions: _Places, a: int, b: int) -> int:
    """Return the axis of the face of the chunk that an edge lies on, or -1."""
    for axis in range(3):
        place = positions[a, axis]
        if place == positions[b, axis] and place in (POSITION_LOW, POSITION_HIGH):
            return axis
    return -1


@kernel
def _count(positions: _Places, triangles: _Indices, lower: _Numbers) -> tuple[int, int]:
    """Number the lower end of each border vertex, by the axis of its face. Returns how many, and the border edges."""
    vertices = edges = 0
    for row in range(triangles.shape[0]):
        for corner in range(3):
            a, b = triangles[row, corner - 1], triangles[row, corner]
            axis = _face_axis(positions, a, b)
            if axis >= 0:
                edges += 1
                for vertex in (a, b):
                    if lower[axis, vertex] < 0:
                        lower[axis, vertex] = positions.shape[0] + vertices
                        vertices += 1
    return vertices, edges


@kernel
def _draw_out(density: _Densities, side: int, apron: int, units: int, lower: _Numbers, positions: _Places) -> None:
    """Write where the lower ends are: in the face, against the gradient, while there is rock.

    density: flat, `side` samples a side, apron included.
    """
    strides, place, down = np.empty(3, np.int64), np.empty(3), np.empty(3)
    strides[0], strides[1], strides[2] = 1, side * side, side
    for axis in range(3):
        for vertex in range(lower.shape[1]):
            if lower[axis, vertex] >= 0:
                _slope(density, strides, apron, units, positions, vertex, place, down)
                down[axis] = 0.0
                length = np.sqrt(down[0] * down[0] + down[1] * down[1] + down[2] * down[2])
                height = 0.0
                while length > 0.0 and height < HEIGHT_CELLS:
                    if not _is_rock_at(density, side, strides, apron, place, down, (height + STEP_CELLS) / length):
                        break
                    height += STEP_CELLS
                on = height * units / length if length > 0.0 else 0.0
                for other in range(3):
                    moved = np.int64(positions[vertex, other]) + np.int64(np.floor(down[other] * on + 0.5))
                    positions[lower[axis, vertex], other] = moved
                positions[lower[axis, vertex], 3] = POSITION_W


@inlined
def _slope(
    density: _Densities,
    strides: _Numbers,
    apron: int,
    units: int,
    positions: _Places,
    vertex: int,
    place: NDArray[np.float64],
    down: NDArray[np.float64],
) -> None:
    """Write where a vertex of the regular mesh is, in cells, and the unit vector against the gradient there."""
    at, along, t = 0, 1, 0.0
    for axis in range(3):
        on = np.int64(positions[vertex, axis]) - POSITION_LOW
        place[axis] = on * (1.0 / units)
        at += (apron + on // units) * strides[axis]
        if on % units:
            along, t = strides[axis], (on % units) * (1.0 / units)
    normal = edge_normal(density, at, at + along, strides[2], strides[1], t)
    for axis in range(3):
        down[axis] = -normal[axis]


@inlined
def _is_rock_at(
    density: _Densities,
    side: int,
    strides: _Numbers,
    apron: int,
    place: NDArray[np.float64],
    down: NDArray[np.float64],
    on: float,
) -> bool:
    """Return whether there is rock at `place + on * down`, interpolated. Beyond the samples, where none knows, yes."""
    at = 0
    for axis in range(3):
        low = np.floor(place[axis] + on * down[axis])
        if low < -apron or low > side - 2 - apron:
            return True
        at += (apron + np.int64(low)) * strides[axis]
    value = 0.0
    for corner in range(8):
        share, there = 1.0, at
        for axis in range(3):
            where = place[axis] + on * down[axis]
            t = where - np.floor(where)
            share *= t if corner >> axis & 1 else 1.0 - t
            there += strides[axis] * (corner >> axis & 1)
        if share > 0.0:
            value += share * np.float64(density[there])
    return is_rock(np.float32(value))


@kernel
def _fill(positions: _Places, lower: _Numbers, surface: int, triangles: _Indices) -> int:
    """Write two triangles for each border edge behind the first `surface` rows. Returns the row after the last.

    The edge is walked back, so that surface and skirt have the same sense. Those with two equal corners are left out.
    """
    at = surface
    for row in range(surface):
        for corner in range(3):
            a, b = triangles[row, corner - 1], triangles[row, corner]
            axis = _face_axis(positions, a, b)
            if axis >= 0:
                triangles[at, 0], triangles[at, 1], triangles[at, 2] = b, a, lower[axis, a]
                at += has_three_places(positions, triangles[at])
                triangles[at, 0], triangles[at, 1], triangles[at, 2] = b, lower[axis, a], lower[axis, b]
                at += has_three_places(positions, triangles[at])
    return at
