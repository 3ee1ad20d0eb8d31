"""What is known of regions and patches of samples: kernels of `skipping`.

A region is bounded. A patch of an open region is settled by the field at its middle, and by how much that can change
up to its samples.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.interpreter import (
    ALL,
    COUNT,
    FIRST_COLUMN,
    FIRST_PLANE,
    LAST_PLANE,
    PROGRAM,
    START,
    WANTED,
)
from chunkserver.field.intervals import ALL_FINITE, ANYWHERE
from chunkserver.field.programs import PROGRAMS_MAX, find_program, prune, write_programs
from chunkserver.kernel import LANES, inlined, kernel, lanes_below

REGION: Final = 12
"""Samples a side."""
PATCH: Final = 2
"""Samples a side."""
PATCHES: Final = REGION // PATCH
REACH: Final = 0.5 * (PATCH - 1)
"""From the middle of a patch to its samples, along each axis, steps."""

ROUNDED_UP: Final = 1 + 2.0**-20
"""More than a rounding to float32 takes away."""
FACE_LAYERS: Final = 3
"""Layers of samples on each face before a coarser neighbour whose values matter, whatever their signs are."""

WORD_BITS: Final = 64
_LANES: Final = np.uint64(LANES)
_ISOVALUE: Final = np.float32(0)
_ONE: Final = np.uint64(1)
_PATCH: Final = np.uint64(PATCH)
_ROW_OF_PATCH: Final = np.uint64((1 << PATCH) - 1)
"""An unsigned index is not checked for being negative: loops over patches take a third of the time."""

AIR, ROCK, OPEN, CLOSE = (np.uint8(kind) for kind in range(4))
"""What is known of a region: nothing but air, nothing but rock; to be looked at by patches, or by samples at once."""

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Code = NDArray[np.int32]
_Bytes = NDArray[np.uint8]
_Words = NDArray[np.uint64]


@kernel
def judge(
    code: _Code,
    numbers: _Doubles,
    reads: _Code,
    columns: int,
    result: int,
    failed: _Code,
    low: _Floats,
    high: _Floats,
    spread: _Doubles,
    own_code: _Code,
    own_keys: NDArray[np.uint32],
    kinds: _Bytes,
    chosen: _Code,
    known: _Bytes,
    states: _Bytes,
    out: _Code,
    out_keys: NDArray[np.uint32],
    starts: _Code,
) -> int:
    """Write kind and program of each region, and the code of all programs; return how many there are.

    code, reads: of the tape that keeps all registers; own_code, own_keys: of the one that is run. states: scratch.
    """
    count = 0
    for region in range(kinds.size):
        lowest, highest = low[result, region], high[result, region]
        finite = failed[region] == ALL_FINITE
        if not finite:
            kinds[region] = CLOSE
        elif lowest >= 0:
            kinds[region] = AIR
        elif highest < 0:
            kinds[region] = ROCK
        else:
            kinds[region] = OPEN if spread[result, region] < max(-lowest, highest) else CLOSE
        prune(code, numbers, reads, columns, low, high, region, finite and count < PROGRAMS_MAX - 1, states)
        chosen[region] = find_program(states, known, count)
        count = max(count, chosen[region] + 1)
    write_programs(own_code, own_keys, columns, known, count, out, out_keys, starts)
    return count


@kernel
def list_work(
    wanted: _Bytes,
    size: int,
    chosen: _Code,
    of_region: int,
    programs: int,
    side: int,
    slab_blocks: int,
    work: _Code,
    listed: NDArray[np.uint32],
) -> int:
    """Write the pieces of work that make all wanted blocks; return how many there are.

    wanted: (y, z, x) of blocks, `size` points a side. chosen: (y, z, x) programs of regions, `of_region`
    blocks a side. side: points a side.
    slab_blocks: how many rows of blocks a slab has. work, listed: out, as `interpreter.run` wants them.
    """
    blocks, regions = wanted.shape[0], chosen.shape[0]
    pieces, at = 0, np.uint64(0)
    for first_row in range(0, blocks, slab_blocks):
        last_row = min(first_row + slab_blocks, blocks)
        start, stop = first_row * size * side, min(last_row * size, side) * side
        for layer in range(blocks):
            region_y = layer // of_region
            for program in range(programs):
                first = at
                for region_z in range(first_row // of_region, (last_row - 1) // of_region + 1):
                    for region_x in range(regions):
                        if chosen[region_y, region_z, region_x] != program:
                            continue
                        near, far = max(region_z * of_region, first_row), min((region_z + 1) * of_region, last_row)
                        for z in range(near, far):
                            for x in range(region_x * of_region, min((region_x + 1) * of_region, blocks)):
                                if wanted[layer, z, x] == 0:
                                    continue
                                for row in range(z * size, min(z * size + size, side)):
                                    for place in range(x * size, min(x * size + size, side)):
                                        listed[at] = row * side + place
                                        at += _ONE
                if at == first:
                    continue
                work[pieces, START], work[pieces, COUNT] = start, stop - start
                work[pieces, PROGRAM] = program
                work[pieces, FIRST_PLANE], work[pieces, LAST_PLANE] = layer * size, min(layer * size + size, side)
                work[pieces, FIRST_COLUMN], work[pieces, WANTED] = first, at - first
                if at - first == stop - start:
                    work[pieces, WANTED] = ALL
                pieces += 1
    return pieces


@kernel
def settle(
    kinds: _Bytes,
    spread: _Doubles,
    middles: _Floats,
    faces: int,
    side: int,
    fill: np.float32,
    rows: _Floats,
    wanted: _Bytes,
    density: _Floats,
) -> None:
    """Write which patches have to be worked out, and the densities of the others: their sign.

    middles: the densities at the middles of patches of OPEN regions, (y, z * x). rows: (3, side, rounded up to whole
    patches) scratch. density: flat.
    """
    patches = wanted.shape[0]
    before, behind = (FACE_LAYERS + PATCH - 1) // PATCH, (side - FACE_LAYERS) // PATCH
    by, known, row, end = rows[0], rows[1], rows[2], np.uint64(side)
    for y in range(np.uint64(patches)):
        for z in range(np.uint64(patches)):
            if z % np.uint64(PATCHES) == 0:
                _around(kinds, spread, int(y) // PATCHES, int(z) // PATCHES, patches, by, known)
            for x in range(np.uint64(patches)):
                value = known[x] if known[x] != 0 else middles[y, z * np.uint64(patches) + x]
                wanted[y, z, x] = not abs(value) > by[x]
                number = fill if value > 0 else -fill
                for place in range(_PATCH):
                    row[_PATCH * x + place] = number
            if faces:
                on_y = (faces & 4 and y < before) or (faces & 8 and y >= behind)
                on_z = (faces & 16 and z < before) or (faces & 32 and z >= behind)
                for x in range(patches):
                    if on_y or on_z or (faces & 1 and x < before) or (faces & 2 and x >= behind):
                        wanted[y, z, x] = 1
            for plane in range(_PATCH * y, min(_PATCH * y + _PATCH, end)):
                for to in range(_PATCH * z, min(_PATCH * z + _PATCH, end)):
                    start = (plane * end + to) * end
                    for place in range(end):
                        density[start + place] = row[place]


@inlined
def _around(kinds: _Bytes, spread: _Doubles, y: int, z: int, patches: int, by: _Floats, known: _Floats) -> None:
    """Write for a row of patches what their middles must be beyond, and 1 for air, -1 for rock, 0 for not known."""
    for x in range(patches):
        kind = kinds[y, z, x // PATCHES]
        by[x] = spread[y, z, x // PATCHES] * ROUNDED_UP if kind == OPEN else 0 if kind < OPEN else ANYWHERE
        known[x] = 0 if kind == OPEN else 1 if kind == AIR else -1


@kernel
def miss(density: _Floats, apron: int, wanted: _Bytes, rock: _Words, ends: _Words) -> int:
    """Replace the patches that were worked out by those that are read but were not; return how many those are.

    Read are the samples at the ends of crossed edges, and their neighbours along the axes. density: flat. rock, ends:
    (y, z, word) scratch.
    """
    side, words = rock.shape[0], rock.shape[2]
    start = np.uint64(0)
    for y in range(side):
        for z in range(side):
            for word in range(words):
                flags, count = np.uint64(0), np.uint64(min(WORD_BITS, side - word * WORD_BITS))
                whole = count - count % _LANES
                for place in range(np.uint64(0), whole, _LANES):
                    flags |= lanes_below(density, start + place, _ISOVALUE) << place
                for place in range(whole, count):
                    flags |= np.uint64(density[start + place] < _ISOVALUE) << place
                rock[y, z, word], ends[y, z, word] = flags, np.uint64(0)
                start += count
    first, last = np.uint64(apron), np.uint64(side - apron)
    for y in range(first, last):
        for z in range(first, last):
            for word in range(np.uint64(words)):
                before = apron - 64 * int(word)
                behind = side - apron - 64 * int(word)
                corner, edge = _places(before, behind), _places(before, behind - 1)
                flags = rock[y, z, word]
                follows = rock[y, z, word + _ONE] << np.uint64(63) if word + _ONE < words else np.uint64(0)
                along = (flags ^ (flags >> _ONE | follows)) & edge
                if along:
                    ends[y, z, word] |= along | along << _ONE
                    if word + _ONE < words:
                        ends[y, z, word + _ONE] |= along >> np.uint64(63)
                across = (flags ^ rock[y, z + _ONE, word]) & corner if z + _ONE < last else np.uint64(0)
                up = (flags ^ rock[y + _ONE, z, word]) & corner if y + _ONE < last else np.uint64(0)
                if across | up:
                    ends[y, z, word] |= across | up
                    ends[y, z + _ONE, word] |= across
                    ends[y + _ONE, z, word] |= up
    return _unread(ends, wanted)


@inlined
def _places(first: int, last: int) -> np.uint64:
    """Return a word with the bits from `first` on set, and before `last`."""
    first, last = max(first, 0), min(last, 64)
    if first >= last:
        return np.uint64(0)
    return (~np.uint64(0) >> np.uint64(64 - (last - first))) << np.uint64(first)


@inlined
def _unread(ends: _Words, wanted: _Bytes) -> int:
    """Replace the wanted patches by those that hold a neighbour of an end and are not wanted; return how many."""
    side, words, patches = np.uint64(ends.shape[0]), np.uint64(ends.shape[2]), np.uint64(wanted.shape[0])
    missed, none = 0, np.uint64(0)
    for y in range(patches):
        for z in range(patches):
            for word in range(words):
                read = none
                for plane in range(_PATCH * y, min(_PATCH * y + _PATCH, side)):
                    for row in range(_PATCH * z, min(_PATCH * z + _PATCH, side)):
                        here = ends[plane, row, word]
                        read |= here | here << _ONE | here >> _ONE
                        read |= ends[plane - _ONE, row, word] if plane > none else none
                        read |= ends[plane + _ONE, row, word] if plane + _ONE < side else none
                        read |= ends[plane, row - _ONE, word] if row > none else none
                        read |= ends[plane, row + _ONE, word] if row + _ONE < side else none
                        if word > none:
                            read |= ends[plane, row, word - _ONE] >> np.uint64(63)
                        if word + _ONE < words:
                            read |= ends[plane, row, word + _ONE] << np.uint64(63)
                low = word * np.uint64(64 // PATCH)
                for x in range(low, min(low + np.uint64(64 // PATCH), patches)):
                    missing = np.uint8(read & _ROW_OF_PATCH != 0) & ~wanted[y, z, x] & np.uint8(1)
                    wanted[y, z, x] = missing
                    missed += missing
                    read >>= _PATCH
    return missed
