"""Skirts, for clients that cannot name their neighbours' level: the border of a chunk, drawn out into the rock.

        this chunk   face   a neighbour of another level
                       |
     air  -------------o                     What gapes between two borders is a piece of the face, and rock in one of
                       | gap                 the two fields. So each border edge of a chunk gets a quad in the face,
     rock        skirt o-------------        down into the rock as far as all of it is rock: it covers the gap, and
                       |                     nothing else that can be seen.

An edge of the mesh lies on a face of the chunk exactly if it is on the border: no diagonal lies in a face of a cell
(`cases.py`). A skirt depends on its own chunk alone.

    o-----o--o-----o     The lower end of a border vertex lies on its ray: in the face, against the gradient. Vertices
    |    /   |    /|     that are close together have one lower end, so that the edge between them costs one triangle.
    |   /    |  /  |     Two rays end where something between them is no longer rock: a quad that reached into a cave,
    |  /     |/    |     or out on the other side of a hill, would be a wall in the air.
    o--------o-----o
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import FACES, POSITION_HIGH, POSITION_LOW
from chunkserver.kernel import inlined, kernel
from chunkserver.mesh import POSITION_W, Mesh, as_indices
from chunkserver.mesher.crossing import is_rock
from chunkserver.mesher.normals import gradient
from chunkserver.mesher.triangles import has_area
from chunkserver.samples import Samples

HEIGHT_CELLS: Final = 6
"""How far a skirt reaches at most: what a neighbour two levels coarser is off by, and less than the margin."""
STEP_CELLS: Final = 1.0
"""How far apart it looks whether there is still rock, down and across."""
SHARED_CELLS: Final = 1.0
"""How near a border vertex is to another whose lower end it shares."""
SEGMENTS_MAX: Final = 2
"""Border edges in a face of a cell."""

assert HEIGHT_CELLS < 16 // 2, "a skirt stays within the margin of the smallest chunk"

_Densities = NDArray[np.float32]
_Places = NDArray[np.uint16]
_Numbers = NDArray[np.int64]
_Indices = NDArray[np.uint32]
_Reals = NDArray[np.float64]


class _Grid(NamedTuple):
    """A chunk's samples. density: flat, `side` samples a side, apron included. units: a cell."""

    density: _Densities
    side: int
    apron: int
    units: int


class _Rays(NamedTuple):
    """Where the lower ends are, in cells: `start + height * down`.

    start: (L, 3), in cells from the chunk's low corner. down: (L, 3), unit, in the face; 0 if no way is down. height:
    (L,), cells. slope: (L,), the length of the density's gradient, a cell.
    """

    start: _Reals
    down: _Reals
    height: _Reals
    slope: _Reals


def with_skirts(mesh: Mesh, samples: Samples) -> Mesh:
    """Return `mesh`, which was extracted from `samples`, with skirts on all six faces of its chunk."""
    shape, surface = samples.shape, len(mesh.triangles)
    edges = np.empty((FACES * SEGMENTS_MAX * shape.cells**2, 3), np.int64)
    plain = mesh.triangles.astype(np.uint32)
    edges = edges[: _list_edges(mesh.positions, plain, edges)]
    if not len(edges):
        return mesh
    lower, owners = np.full((3, len(mesh.positions)), -1, np.int64), np.empty((2 * len(edges), 2), np.int64)
    owners = owners[: _number(mesh.positions, edges, int(SHARED_CELLS * shape.units_per_cell), lower, owners)]
    rays = _Rays(*(np.empty((len(owners), *rest)) for rest in ((3,), (3,), (), ())))
    _draw_out(
        _Grid(samples.density.reshape(-1), shape.samples, shape.apron, shape.units_per_cell),
        *(mesh.positions, edges, lower, owners, rays),
    )
    ends = np.floor((rays.start + rays.height[:, None] * rays.down) * shape.units_per_cell + 0.5) + POSITION_LOW
    positions = np.concatenate([mesh.positions, np.full((len(owners), 4), POSITION_W, np.uint16)])
    positions[len(mesh.positions) :, :3] = ends
    triangles = np.concatenate([plain, np.empty((2 * len(edges), 3), np.uint32)])
    triangles = triangles[: _fill(positions, edges, lower, surface, triangles)]
    normals = np.concatenate([mesh.normals, mesh.normals[owners[:, 0]]])
    return Mesh(mesh.content, positions, normals, as_indices(triangles, len(positions)))


@kernel
def _list_edges(positions: _Places, triangles: _Indices, edges: _Numbers) -> int:
    """Write the border edges: from, to, axis of the face. Returns how many there are."""
    count = 0
    for row in range(triangles.shape[0]):
        for corner in range(3):
            a, b = triangles[row, corner - 1], triangles[row, corner]
            for axis in range(3):
                place = positions[a, axis]
                if place == positions[b, axis] and place in (POSITION_LOW, POSITION_HIGH):
                    edges[count, 0], edges[count, 1], edges[count, 2] = a, b, axis
                    count += 1
                    break
    return count


@kernel
def _number(positions: _Places, edges: _Numbers, near: int, lower: _Numbers, owners: _Numbers) -> int:
    """Number the lower ends of border vertices. Returns how many there are.

    lower: (3, V), by the axis of the face and the vertex, counted on from the vertices of the mesh; -1 for none.
    owners: (L, 2), the vertex that each lower end was made for, and the axis. near: units.
    """
    count = 0
    for row in range(edges.shape[0]):
        axis = edges[row, 2]
        for side in range(2):
            vertex, other = edges[row, side], edges[row, 1 - side]
            if lower[axis, vertex] >= 0:
                continue
            beside = lower[axis, other]
            if beside >= 0 and _may_share(positions, vertex, axis, owners[beside - positions.shape[0], 0], near):
                lower[axis, vertex] = beside
            else:
                lower[axis, vertex] = positions.shape[0] + count
                owners[count, 0], owners[count, 1] = vertex, axis
                count += 1
    return count


@inlined
def _may_share(positions: _Places, vertex: int, face_axis: int, owner: int, near: int) -> bool:
    """Return whether a vertex is near the owner of a lower end. Where the face ends, skirts go on down: it may not."""
    square = 0
    for axis in range(3):
        place = int(positions[vertex, axis])
        if axis != face_axis and place in (POSITION_LOW, POSITION_HIGH):
            return False
        apart = place - int(positions[owner, axis])
        square += apart * apart
    return square <= near * near


@kernel
def _draw_out(grid: _Grid, positions: _Places, edges: _Numbers, lower: _Numbers, owners: _Numbers, rays: _Rays) -> None:
    """Write the rays: as long as between the two of each border edge there is nothing but rock."""
    shares = np.empty(3)
    for at in range(owners.shape[0]):
        _aim(grid, positions, owners[at, 0], owners[at, 1], rays, at)
    for row in range(edges.shape[0]):
        a = lower[edges[row, 2], edges[row, 0]] - positions.shape[0]
        b = lower[edges[row, 2], edges[row, 1]] - positions.shape[0]
        height, reach = 0.0, max(rays.height[a], rays.height[b])
        while height < reach and _is_rock_between(grid, rays, a, b, height + STEP_CELLS, shares):
            height += STEP_CELLS
        rays.height[a], rays.height[b] = min(rays.height[a], height), min(rays.height[b], height)


@inlined
def _aim(grid: _Grid, positions: _Places, vertex: int, face_axis: int, rays: _Rays, at: int) -> None:
    """Write the ray of a vertex of the regular mesh, as long as can be."""
    strides = (1, grid.side * grid.side, grid.side)
    low, along, t = 0, 1, 0.0
    for axis in range(3):
        on = int(positions[vertex, axis]) - POSITION_LOW
        rays.start[at, axis] = on * (1.0 / grid.units)
        low += (grid.apron + on // grid.units) * strides[axis]
        if on % grid.units:
            along, t = strides[axis], (on % grid.units) * (1.0 / grid.units)
    one = gradient(grid.density, low, strides[2], strides[1])
    two = gradient(grid.density, low + along, strides[2], strides[1])
    slope = square = 0.0
    for axis in range(3):
        uphill = 0.5 * (one[axis] + t * (two[axis] - one[axis]))
        slope += uphill * uphill
        rays.down[at, axis] = 0.0 if axis == face_axis else -uphill
        square += rays.down[at, axis] * rays.down[at, axis]
    if square > 0.0:
        length = np.sqrt(square)
        for axis in range(3):  # an operation on a row would be as fast, and take four seconds to compile
            rays.down[at, axis] /= length
    rays.slope[at], rays.height[at] = np.sqrt(slope), HEIGHT_CELLS if square > 0.0 else 0.0


@inlined
def _is_rock_between(grid: _Grid, rays: _Rays, a: int, b: int, height: float, shares: _Reals) -> bool:
    """Return whether there is rock on the line between two rays at a height, or their ends where those are higher."""
    on_a, on_b, far = min(height, rays.height[a]), min(height, rays.height[b]), 0.0
    for axis in range(3):
        far = max(far, abs(_place(rays, b, axis, on_b) - _place(rays, a, axis, on_a)))
    parts = 1 + int(far / STEP_CELLS)
    part = 0
    while part <= parts and _is_rock_at(grid, rays, a, b, on_a, on_b, part / parts, shares):
        part += 1
    return part > parts


@inlined
def _place(rays: _Rays, at: int, axis: int, height: float) -> float:
    return float(rays.start[at, axis] + height * rays.down[at, axis])


@inlined
def _is_rock_at(grid: _Grid, rays: _Rays, a: int, b: int, on_a: float, on_b: float, t: float, shares: _Reals) -> bool:
    """Return whether there is rock at `t` on the line from one ray to another, interpolated.

    Beyond the samples density is taken to rise as fast as it does where the rays begin. shares: (3,), written.
    """
    last, strides = grid.side - 1 - grid.apron, (1, grid.side * grid.side, grid.side)
    low, value, slope = 0, 0.0, max(rays.slope[a], rays.slope[b])
    for axis in range(3):
        place = (1.0 - t) * _place(rays, a, axis, on_a) + t * _place(rays, b, axis, on_b)
        known = min(max(place, -grid.apron), last)
        value += slope * abs(place - known)
        first = min(int(np.floor(known)), last - 1)
        shares[axis] = known - first
        low += (grid.apron + first) * strides[axis]
    for corner in range(8):
        weight, at = 1.0, low
        for axis in range(3):
            high = corner >> axis & 1
            weight *= shares[axis] if high else 1.0 - shares[axis]
            at += high * strides[axis]
        value += weight * np.float64(grid.density[at])
    return is_rock(np.float32(value))


@kernel
def _fill(positions: _Places, edges: _Numbers, lower: _Numbers, surface: int, triangles: _Indices) -> int:
    """Write two triangles for each border edge behind the first `surface` rows. Returns the row after the last.

    The edge is walked back, so that surface and skirt have the same sense. Those without an area are left out.
    """
    at = surface
    for row in range(edges.shape[0]):
        a, b, axis = edges[row, 0], edges[row, 1], edges[row, 2]
        triangles[at, 0], triangles[at, 1], triangles[at, 2] = b, a, lower[axis, a]
        at += has_area(positions, triangles, at)
        triangles[at, 0], triangles[at, 1], triangles[at, 2] = b, lower[axis, a], lower[axis, b]
        at += has_area(positions, triangles, at)
    return at
