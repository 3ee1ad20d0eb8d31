r"""Room for transition cells: vertices less than a cell from a masked face slide towards the chunk's inside.

        masked face            d < 1 cell from the face becomes d + (1 - d) / 4. The vertex stays on its tangent plane,
             |   o'            so that the surface keeps its shape. Where that lies along the face, there is no end to
    air      |  /     rock     the way: a vertex goes `SLIDE_CELLS` at most. Where a triangle would turn over, its
             | o               vertices go only half of their way, or half of that.

**A vertex that touches a face of the chunk that is not masked does not move**: so neighbours that know nothing of this
border still fit, and two masked faces of different chunks meet in a line. All other vertices are in no other chunk.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver.kernel import inlined, kernel
from chunkserver.mesher.normals import edge_gradient
from chunkserver.samples import Samples

SLIDE_CELLS: Final = 1.0
"""How far a vertex goes at most, in cells."""
SETTLES_MAX: Final = 64
"""How often moves are halved. White noise takes a dozen times; what turns still has no room made at all."""

_Densities = NDArray[np.float32]
_Places = NDArray[np.uint16]
_Triangles = NDArray[np.uint32]
_Vector = tuple[float, float, float]

_MOVED, _CHANGED, _BACK = 1, 2, 4
"""Flags of a vertex: it is not where it was; it is not where the last look at its triangles found it; too far."""


def make_room(samples: Samples, positions: _Places, triangles: _Triangles) -> None:
    """Move every vertex of the regular mesh that is in the way of the transition cells of its chunk.

    positions: (V, 4), changed. triangles: (T, 3). No triangle is turned over by it, or loses its area
    (`tests/unit/mesher/test_room.py`).
    """
    shape, before = samples.shape, positions.copy()
    moves = np.zeros(len(positions), np.uint8)
    density, side, units = samples.density.reshape(-1), shape.samples, shape.units_per_cell
    _move_all(density, side, shape.apron, units, samples.coarser, before, positions, moves)
    if not _settle(before, positions, triangles, moves):
        positions[:] = before


@inlined
def room(positions: _Places, vertex: int, mask: int, units: int) -> _Vector:
    """Return how far from its masked faces a vertex has to get, (x, y, z) in units. units: a cell."""
    x, y, z = int(positions[vertex, 0]), int(positions[vertex, 1]), int(positions[vertex, 2])
    if _is_held(x, mask & 3) or _is_held(y, mask >> 2 & 3) or _is_held(z, mask >> 4 & 3):
        return 0.0, 0.0, 0.0
    return _away(x, mask & 3, units), _away(y, mask >> 2 & 3, units), _away(z, mask >> 4 & 3, units)


@inlined
def _is_held(place: int, masked: int) -> bool:
    """Return whether a vertex touches a face of an axis that is not masked. masked: 1 if the low one is, 2 the high."""
    return (place == POSITION_LOW and not masked & 1) or (place == POSITION_HIGH and not masked & 2)


@inlined
def _away(place: int, masked: int, units: int) -> float:
    """Return how far a vertex has to get on an axis. masked: as in `_is_held`."""
    low, high = place - POSITION_LOW, POSITION_HIGH - place
    if masked & 1 and low < units:
        return (units - low) * 0.25
    return (high - units) * 0.25 if masked & 2 and high < units else 0.0


@kernel
def _move_all(
    density: _Densities,
    side: int,
    apron: int,
    units: int,
    mask: int,
    before: _Places,
    positions: _Places,
    moves: NDArray[np.uint8],
) -> None:
    """Move each vertex for itself. density: flat, `side` samples a side. before: (V, 4). positions, moves: out."""
    low, high = POSITION_LOW + units, POSITION_HIGH - units
    for vertex in range(positions.shape[0]):
        x, y, z = int(before[vertex, 0]), int(before[vertex, 1]), int(before[vertex, 2])
        if low <= min(x, y, z) and max(x, y, z) <= high:
            continue
        away = room(before, vertex, mask, units)
        if away[0] != 0.0 or away[1] != 0.0 or away[2] != 0.0:
            slid = _slid(away, _gradient_at(density, side, apron, units, x, y, z), SLIDE_CELLS * units)
            for axis in range(3):
                place = int(before[vertex, axis])
                on = _within(place, int(np.floor(slid[axis] + 0.5)), away[axis])
                positions[vertex, axis] = place + on
                if on:
                    moves[vertex] = _MOVED | _CHANGED


@inlined
def _gradient_at(density: _Densities, side: int, apron: int, units: int, x: int, y: int, z: int) -> _Vector:
    """Return a vector along the gradient at a vertex of the regular mesh, from its position."""
    at = apron * (side * side + side + 1)
    along, t = 1, 0
    for place, stride in ((x - POSITION_LOW, 1), (y - POSITION_LOW, side * side), (z - POSITION_LOW, side)):
        at += place // units * stride
        if place % units:
            along, t = stride, place % units
    return edge_gradient(density, at, at + along, side, side * side, t * (1.0 / units))


@inlined
def _slid(away: _Vector, slope: _Vector, most: float) -> _Vector:
    """Return the way along the plane across `slope` that gets as far as `away` does, but for `most`."""
    (x, y, z), (u, v, w) = away, slope
    square, steep = x * x + y * y + z * z, u * u + v * v + w * w
    if steep > 0.0:
        up = (x * u + y * v + z * w) / steep
        x, y, z = x - up * u, y - up * v, z - up * w
    along = x * x + y * y + z * z
    if along == 0.0:
        return 0.0, 0.0, 0.0
    stretch = square / along
    if stretch * square > most * most:
        stretch = most / np.sqrt(along)
    return x * stretch, y * stretch, z * stretch


@inlined
def _within(place: int, on: int, away: float) -> int:
    """Return how far a vertex goes on an axis: not back to its masked face, and half of what is left to a face."""
    if on * away < 0.0:
        return 0
    return min(max(on, -((place - POSITION_LOW) // 2)), (POSITION_HIGH - place) // 2)


@kernel
def _settle(before: _Places, positions: _Places, triangles: _Triangles, moves: NDArray[np.uint8]) -> bool:
    """Take back half of the moves that turn a triangle, all at once: so their order does not matter.

    Again, until none turns any more. Returns whether it came to that.
    """
    touched, count = np.empty(triangles.shape[0], np.int64), 0
    for row in range(triangles.shape[0]):
        touched[count] = row
        count += int(moves[triangles[row, 0]] | moves[triangles[row, 1]] | moves[triangles[row, 2]]) & _MOVED
    for _ in range(SETTLES_MAX):
        turns = False
        for place in range(count):
            row = touched[place]
            a, b, c = triangles[row, 0], triangles[row, 1], triangles[row, 2]
            if (moves[a] | moves[b] | moves[c]) & _CHANGED and _is_turned(before, positions, a, b, c):
                turns = True
                for corner in range(3):
                    moves[triangles[row, corner]] |= _BACK
        if not turns:
            return True
        for vertex in range(moves.shape[0]):
            if moves[vertex] & _BACK:
                moves[vertex] = _CHANGED | _halve(before, positions, vertex)
            else:
                moves[vertex] &= _MOVED
    return False


@inlined
def _is_turned(before: _Places, positions: _Places, a: int, b: int, c: int) -> bool:
    """Return whether a triangle has turned by 60 degrees or more, or has no area any more."""
    x, y, z = _cross(positions, a, b, c)
    u, v, w = _cross(before, a, b, c)
    dot = x * u + y * v + z * w
    return dot <= 0.0 or 4.0 * dot * dot <= (x * x + y * y + z * z) * (u * u + v * v + w * w)


@inlined
def _cross(positions: _Places, a: int, b: int, c: int) -> _Vector:
    """Return a vector along the normal of a triangle, twice as long as its area is large."""
    ux, uy, uz = _from(positions, a, b)
    vx, vy, vz = _from(positions, a, c)
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@inlined
def _from(positions: _Places, a: int, b: int) -> _Vector:
    return (
        np.float64(positions[b, 0]) - np.float64(positions[a, 0]),
        np.float64(positions[b, 1]) - np.float64(positions[a, 1]),
        np.float64(positions[b, 2]) - np.float64(positions[a, 2]),
    )


@inlined
def _halve(before: _Places, positions: _Places, vertex: int) -> int:
    """Take back half of a vertex's move. Returns `_MOVED` if there is some of it left."""
    moves = 0
    for axis in range(3):
        start = np.int64(before[vertex, axis])
        on = np.int64(positions[vertex, axis]) - start
        on = on // 2 if on > 0 else -(-on // 2)
        positions[vertex, axis] = start + on
        if on:
            moves = _MOVED
    return moves
