"""Positions and normals of the regular mesh, many vertices at a time.

What a vertex reads lies far apart, what is worked out from it does not depend on any other vertex. So a block of
vertices is taken in steps, each a loop over all of it: what has to be loaded one by one is gathered into rows that lie
close together, and the arithmetic on them is done a vector of vertices at a time. The formulas are those of
`crossing.py` and `normals.py`, to the bit.
"""

import sys
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_LOW
from chunkserver.kernel import inlined, kernel, uncounted
from chunkserver.mesh import POSITION_W
from chunkserver.mesher.crossing import crossing, is_rock
from chunkserver.mesher.normals import as_byte, between, unit
from chunkserver.mesher.rows import SLOT_X

BLOCK: Final = 128
"""Vertices that are worked on together: what they gather stays in the nearest cache."""

GATHERED: Final = 14
"""Samples of a vertex: both ends of its edge, and what is before and after each of them on three axes."""

assert sys.byteorder == "little", "a position, and a normal of bytes, is written as one number, lowest part first"

_LOW_CORNER: Final = np.uint64(POSITION_LOW | POSITION_LOW << 16 | POSITION_LOW << 32 | POSITION_W << 48)
_AXIS: Final = np.uint32(3)

_Densities = NDArray[np.float32]
_Slots = NDArray[np.uint32]
_Words = NDArray[np.uint64]
_Reals = NDArray[np.float64]


@kernel
def fill_vertices(
    density: _Densities,
    strides: _Words,
    apron: int,
    units: int,
    bits: int,
    slots: _Slots,
    positions: _Words,
    as_int8: NDArray[np.uint32],
    as_float32: _Densities,
) -> None:
    """Write position and normal of every vertex.

    density: flat. strides: (3,), how far apart samples are in x, y and z. units: a cell. slots: (V,), where each vertex
    is. positions: (V,) out, four u16 each. as_int8: (V,) out, four int8 each, or empty. as_float32: (3 * V,) out, or
    empty.
    """
    density, strides, slots, positions = uncounted(density), uncounted(strides), uncounted(slots), uncounted(positions)
    as_int8, as_float32 = uncounted(as_int8), uncounted(as_float32)
    lows, gathered = np.empty(BLOCK, np.uint32), np.empty(GATHERED * BLOCK, np.float32)
    normals = np.empty(3 * BLOCK, np.float64)
    share = 1.0 / units
    for first in range(0, slots.size, BLOCK):
        start, count = np.uint64(first), min(BLOCK, slots.size - first)
        _place(slots, start, count, bits, strides, apron, units, lows, positions)
        _gather(density, strides, slots, start, count, lows, gathered)
        _cross(slots, start, count, units, gathered, positions)
        if _point(gathered, count, share, normals) > 0:
            _point_flat(slots, start, count, gathered, normals)
        if as_int8.size > 0:
            _store_int8(normals, start, count, as_int8)
        else:
            _store_float32(normals, start, count, as_float32)


@inlined
def _corner(slot: np.uint32, bits: int) -> tuple[np.uint32, np.uint32, np.uint32]:
    """Return x, y, z of the corner that an edge starts at, in cells."""
    mask, width = (np.uint32(1) << np.uint32(bits)) - np.uint32(1), np.uint32(bits)
    place = slot >> np.uint32(SLOT_X)
    return place & mask, place >> width + width, place >> width & mask


@inlined
def _place(
    slots: _Slots,
    start: np.uint64,
    count: int,
    bits: int,
    strides: _Words,
    apron: int,
    units: int,
    lows: _Slots,
    positions: _Words,
) -> None:
    """Write the flat index of the corner that each edge starts at, and its position."""
    ring, plane, row = np.uint32(apron), np.uint32(strides[1]), np.uint32(strides[2])
    for i in range(count):
        x, y, z = _corner(slots[start + np.uint64(i)], bits)
        lows[i] = (y + ring) * plane + (z + ring) * row + x + ring
    for i in range(count):
        x, y, z = _corner(slots[start + np.uint64(i)], bits)
        cells = np.uint64(x) | np.uint64(y) << np.uint64(16) | np.uint64(z) << np.uint64(32)
        positions[start + np.uint64(i)] = _LOW_CORNER + cells * np.uint64(units)


@inlined
def _gather(
    density: _Densities,
    strides: _Words,
    slots: _Slots,
    start: np.uint64,
    count: int,
    lows: _Slots,
    gathered: _Densities,
) -> None:
    """Copy the samples of a block: a row of low ends, one of high ends, then those around each, before and after."""
    one, plane, row = strides[0], strides[1], strides[2]
    for i in range(count):
        low = np.uint64(lows[i])
        high = low + strides[slots[start + np.uint64(i)] & _AXIS]
        gathered[i], gathered[BLOCK + i] = density[low], density[high]
        gathered[2 * BLOCK + i], gathered[3 * BLOCK + i] = density[low - one], density[low + one]
        gathered[4 * BLOCK + i], gathered[5 * BLOCK + i] = density[low - plane], density[low + plane]
        gathered[6 * BLOCK + i], gathered[7 * BLOCK + i] = density[low - row], density[low + row]
        gathered[8 * BLOCK + i], gathered[9 * BLOCK + i] = density[high - one], density[high + one]
        gathered[10 * BLOCK + i], gathered[11 * BLOCK + i] = density[high - plane], density[high + plane]
        gathered[12 * BLOCK + i], gathered[13 * BLOCK + i] = density[high - row], density[high + row]


@inlined
def _cross(slots: _Slots, start: np.uint64, count: int, units: int, gathered: _Densities, positions: _Words) -> None:
    """Move each position along its edge; put how far, in units, in place of the low ends."""
    for i in range(count):
        units_on = crossing(gathered[i], gathered[BLOCK + i], units)
        axis = np.uint64(slots[start + np.uint64(i)] & _AXIS)
        positions[start + np.uint64(i)] += np.uint64(units_on) << (axis << np.uint64(4))
        gathered[i] = np.float32(units_on)


@inlined
def _difference(gathered: _Densities, after: int, i: int) -> np.float64:
    return np.float64(gathered[after * BLOCK + i]) - np.float64(gathered[(after - 1) * BLOCK + i])


@inlined
def _point(gathered: _Densities, count: int, share: float, normals: _Reals) -> int:
    """Write the unit normals of a block: a row of x, one of y, one of z. Returns how many are 0."""
    flat = 0
    for i in range(count):
        low = _difference(gathered, 3, i), _difference(gathered, 5, i), _difference(gathered, 7, i)
        high = _difference(gathered, 9, i), _difference(gathered, 11, i), _difference(gathered, 13, i)
        x, y, z, square = unit(between(low, high, np.float64(gathered[i]) * share))
        normals[i], normals[BLOCK + i], normals[2 * BLOCK + i] = x, y, z
        flat += square == 0.0
    return flat


@inlined
def _point_flat(slots: _Slots, start: np.uint64, count: int, gathered: _Densities, normals: _Reals) -> None:
    """Point the normals that are 0 along their edge, towards its air corner."""
    for i in range(count):
        if normals[i] == 0.0 and normals[BLOCK + i] == 0.0 and normals[2 * BLOCK + i] == 0.0:
            towards_air = -1.0 if is_rock(gathered[BLOCK + i]) else 1.0
            for axis in range(3):
                normals[axis * BLOCK + i] = towards_air * (slots[start + np.uint64(i)] & _AXIS == np.uint32(axis))


@inlined
def _store_int8(normals: _Reals, start: np.uint64, count: int, as_int8: NDArray[np.uint32]) -> None:
    """Write the normals of a block as four int8 each, the fourth 0."""
    byte = np.uint32(255)
    for i in range(count):
        x, y = np.uint32(as_byte(normals[i])) & byte, np.uint32(as_byte(normals[BLOCK + i])) & byte
        z = np.uint32(as_byte(normals[2 * BLOCK + i])) & byte
        as_int8[start + np.uint64(i)] = x | y << np.uint32(8) | z << np.uint32(16)


@inlined
def _store_float32(normals: _Reals, start: np.uint64, count: int, as_float32: _Densities) -> None:
    """Write the normals of a block as three float32 each."""
    at = start * np.uint64(3)
    for i in range(count):
        for axis in range(3):
            as_float32[at + np.uint64(3 * i + axis)] = np.float32(normals[axis * BLOCK + i])
