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
    FIRST_LISTED,
    FIRST_PLANE,
    LAST_PLANE,
    PROGRAM,
    START,
    WANTED,
)
from chunkserver.field.intervals import ALL_FINITE, ANYWHERE
from chunkserver.field.programs import AS_IT_IS, WHOLE, find_program, prune, write_programs
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

WORD_BITS: Final = 64
_LANES: Final = np.uint64(LANES)
_ISOVALUE: Final = np.float32(0)
_ONE: Final = np.uint64(1)
_PATCH: Final = np.uint64(PATCH)
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
    """Write the kind of each region (y, z, x), the program of each row of them (y, z), and the code of all programs.

    A row has the program of its regions if it is the same, or else the whole tape. Returns how many programs there are.

    code, reads: of the tape that keeps all registers; own_code, own_keys: of the one that is run. states: scratch.
    """
    for at in range(code.shape[0]):
        known[WHOLE, at] = AS_IT_IS
    count, regions = 1, kinds.shape[2]
    for row in range(chosen.size):
        for x in range(regions):
            region = row * regions + x
            lowest, highest = low[result, region], high[result, region]
            kind, program = CLOSE, WHOLE
            if failed[region] == ALL_FINITE:
                if lowest >= 0:
                    kind = AIR
                elif highest < 0:
                    kind = ROCK
                elif spread[result, region] < max(-lowest, highest):
                    kind = OPEN
                prune(code, numbers, reads, columns, low, high, region, states)
                program = find_program(states, known, count)
                count = max(count, program + 1)
            y, z = row // regions, row % regions
            kinds[y, z, x] = kind
            if x == 0 or program != chosen[y, z]:
                chosen[y, z] = program if x == 0 else WHOLE
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
    listed: _Code,
) -> int:
    """Write the pieces of work that make all wanted rows; return how many there are.

    wanted: (y, z) of rows of blocks, `size` points a side. chosen: (y, z) programs of rows of regions, `of_region`
    blocks a side. side: points a side. slab_blocks: how many rows of blocks a slab has. work, listed: out, as
    `interpreter.run` wants them.
    """
    blocks, pieces, at = wanted.shape[0], 0, 0
    for first_row in range(0, blocks, slab_blocks):
        last_row = min(first_row + slab_blocks, blocks)
        start, rows = first_row * size * side, min(last_row * size, side) - first_row * size
        for layer in range(blocks):
            for program in range(programs):
                first = at
                for z in range(first_row, last_row):
                    if wanted[layer, z] != 0 and chosen[layer // of_region, z // of_region] == program:
                        for row in range(z * size, min(z * size + size, side)):
                            listed[at] = row
                            at += 1
                if at == first:
                    continue
                work[pieces, START], work[pieces, COUNT] = start, rows * side
                work[pieces, PROGRAM] = program
                work[pieces, FIRST_PLANE], work[pieces, LAST_PLANE] = layer * size, min(layer * size + size, side)
                work[pieces, FIRST_LISTED], work[pieces, WANTED] = first, at - first
                if at - first == rows:
                    work[pieces, WANTED] = ALL
                pieces += 1
    return pieces


@kernel
def settle(
    kinds: _Bytes,
    spread: _Doubles,
    middles: _Floats,
    faces: int,
    layers: int,
    side: int,
    fill: np.float32,
    rows: _Floats,
    wanted: _Bytes,
    density: _Floats,
) -> None:
    """Write which rows of patches, (y, z), have to be worked out, and the densities of the others: their sign.

    middles: the densities at the middles of patches of OPEN regions, (y, z * x). layers: how many layers of samples
    matter on each face of `faces`, whatever their signs are. rows: (3, side, rounded up to whole patches) scratch.
    density: flat.
    """
    patches = wanted.shape[0]
    before, behind = (layers + PATCH - 1) // PATCH, (side - layers) // PATCH
    by, known, row, end = rows[0], rows[1], rows[2], np.uint64(side)
    for y in range(np.uint64(patches)):
        for z in range(np.uint64(patches)):
            if z % np.uint64(PATCHES) == 0:
                _around(kinds, spread, int(y) // PATCHES, int(z) // PATCHES, patches, by, known)
            open_ones = 0
            for x in range(np.uint64(patches)):
                value = known[x] if known[x] != 0 else middles[y, z * np.uint64(patches) + x]
                open_ones += not abs(value) > by[x]
                number = fill if value > 0 else -fill
                for place in range(_PATCH):
                    row[_PATCH * x + place] = number
            on_y = (faces & 4 and y < before) or (faces & 8 and y >= behind)
            on_z = (faces & 16 and z < before) or (faces & 32 and z >= behind)
            wanted[y, z] = open_ones > 0 or on_y or on_z or faces & 3 > 0
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
    """Replace the rows of patches that were worked out by those that are read but were not; return how many those are.

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
    """Replace the wanted rows by those that hold a neighbour of an end and are not wanted; return how many."""
    side, words, patches = np.uint64(ends.shape[0]), np.uint64(ends.shape[2]), np.uint64(wanted.shape[0])
    missed, none = 0, np.uint64(0)
    for y in range(patches):
        for z in range(patches):
            read = none
            for word in range(words):
                for plane in range(_PATCH * y, min(_PATCH * y + _PATCH, side)):
                    for row in range(_PATCH * z, min(_PATCH * z + _PATCH, side)):
                        read |= ends[plane, row, word]
                        read |= ends[plane - _ONE, row, word] if plane > none else none
                        read |= ends[plane + _ONE, row, word] if plane + _ONE < side else none
                        read |= ends[plane, row - _ONE, word] if row > none else none
                        read |= ends[plane, row + _ONE, word] if row + _ONE < side else none
            missing = np.uint8(read != none) & ~wanted[y, z] & np.uint8(1)
            wanted[y, z] = missing
            missed += missing
    return missed
