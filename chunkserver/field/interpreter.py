"""The one compiled interpreter that runs every tape: a dispatch per instruction, a loop over a slab of points inside.

A slab is some rows of a horizontal plane, SLAB_POINTS at most, whose registers stay in the first or second level of
cache. What does not depend on y is worked out once for a slab, the rest for the planes that need it:

    for each piece of work
        if its slab is another one      the leading instructions, for all columns of the slab: x, z
        for each of its planes: y
            the instructions of its program, for all rows of the slab or for those that it lists

A piece of work that lists its rows takes what they share from the slab's registers into registers of its own, so the
loops below run over nothing but the rows that are wanted (`field.skipping`). Rows stay whole: noise works out once per
row, and once for all rows, what the points of a row have in common.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.arithmetic import combine
from chunkserver.field.coordinates import move
from chunkserver.field.noise.blended import add_blended
from chunkserver.field.noise.cellular import add_cellular2, add_cellular3
from chunkserver.field.noise.lattice import BLOCK, ROW_LEAST
from chunkserver.field.noise.simplex2 import add_simplex2
from chunkserver.field.noise.simplex3 import add_simplex3
from chunkserver.field.noise.white import white
from chunkserver.field.shapes import distances
from chunkserver.kernel import kernel, spliced, uncounted

SLAB_POINTS: Final = 1280
"""5 KB a value register, 10 KB a coordinate register. A plane of 32 cells, apron included, is one slab."""

DENSITY_MAX: Final = np.float32(65536)
"""The field is clamped to +-DENSITY_MAX voxels, so that edits add to it without overflow, or to +-CELLS_MAX cells where
that is more: a surface and its normals depend on no clamped sample, unless the density changes by more than 16,384 in a
voxel."""
CELLS_MAX: Final = np.float32(4)

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Words = NDArray[np.uint32]
_Code = NDArray[np.int32]


START: Final = 0
COUNT: Final = 1
PROGRAM: Final = 2
FIRST_PLANE: Final = 3
LAST_PLANE: Final = 4
FIRST_LISTED: Final = 5
WANTED: Final = 6
"""Columns of a piece of work: its slab, which points of a plane; its program; its planes, the last one excluded; its
rows, as a part of a list: how many, or ALL of the slab."""
WORK_COLUMNS: Final = 7
ALL: Final = -1
NONE_READY: Final = -1


@kernel
def run(
    code: _Code,
    starts: _Code,
    numbers: _Doubles,
    keys: _Words,
    shared_places: _Code,
    shared_values: _Code,
    result: int,
    low: _Doubles,
    step: float,
    rows: int,
    ready: int,
    work: _Code,
    listed: _Code,
    places: _Doubles,
    values: _Floats,
    fractions: _Floats,
    words: _Words,
    density: _Floats,
) -> None:
    """Evaluate a tape over a box of points, or over one slab of any points.

    code, keys: the instructions that do not depend on y, then one or more programs of those that do; starts: where each
        program starts in them, and the end of the last one. result: the value register that holds the density.
    shared_places, shared_values: the registers of the slab that programs read.
    low: (3,) coordinates x, y, z of the first point, voxels. step: voxels between points. rows: points along z; 0 if
        the points are those whose coordinates are in the first three places already: there is one plane of them then.
    ready: the start of the slab whose columns are in the registers already, or NONE_READY.
    work: (n, WORK_COLUMNS) int32, pieces of one slab one after the other. listed: numbers of rows in their plane.
    places: (2, coordinate registers, slab) and values: (2, value registers, slab) scratch, of slabs and of pieces that
        list their rows. fractions, words: scratch too, as `noise.lattice.scratch` makes them.
    density: (planes, rows * points along x) out, a horizontal plane each, y upwards, z slow and x fast.
    """
    code, numbers, keys, listed = uncounted(code), uncounted(numbers), uncounted(keys), uncounted(listed)
    places, values, density = uncounted(places), uncounted(values), uncounted(density)
    fractions, words = uncounted(fractions), uncounted(words)
    limit = max(DENSITY_MAX, CELLS_MAX * np.float32(step))
    width = density.shape[1] // max(rows, 1)
    y_stride = 1 if rows == 0 or _reads_every_y(code, starts[0], width) else width
    last_start = ready
    for piece in range(work.shape[0]):
        start, n = work[piece, START], work[piece, COUNT]
        first, wanted = work[piece, FIRST_LISTED], work[piece, WANTED]
        own = 0 if wanted == ALL else 1
        its_rows = listed[first : first + wanted] if own else listed[:0]
        if start != last_start and rows:
            _columns(start, width, low, step, n, places[0, 0], places[0, 2])
        for plane in range(work[piece, FIRST_PLANE] - (start != last_start), work[piece, LAST_PLANE]):
            of_slab = start != last_start
            at_places, at_values = places[0 if of_slab else own], values[0 if of_slab else own]
            at, end, count = 0, starts[0], n
            if not of_slab:
                at, end = starts[work[piece, PROGRAM]], starts[work[piece, PROGRAM] + 1]
                if own and plane == work[piece, FIRST_PLANE]:
                    _take(its_rows, start, width, shared_places, shared_values, places, values)
                count = wanted * width if own else n
                if rows and at < end:
                    _level(low[1] + step * plane, count, y_stride, at_places)
            while at < end:
                _execute(code, at, numbers, keys, count, at_places, at_values, fractions, words, width if rows else 0)
                at += 1
            last_start = start
            if of_slab:
                continue
            if own:
                _place(at_values[result], limit, its_rows, width, density[plane])
            else:
                _clamp(at_values[result, :n], limit, density[plane, start : start + n])


@kernel
def _take(
    listed: _Code,
    start: int,
    width: int,
    shared_places: _Code,
    shared_values: _Code,
    places: _Doubles,
    values: _Floats,
) -> None:
    """Copy what listed rows share from the slab's registers to the second set."""
    for number in range(shared_places.size):
        place, own_place = places[0, shared_places[number], :], places[1, shared_places[number], :]
        for i in range(listed.size):
            at, to = np.uint64(listed[i] * width - start), np.uint64(i * width)
            for x in range(np.uint64(width)):
                own_place[to + x] = place[at + x]
    for number in range(shared_values.size):
        value, own_value = values[0, shared_values[number], :], values[1, shared_values[number], :]
        for i in range(listed.size):
            at, to = np.uint64(listed[i] * width - start), np.uint64(i * width)
            for x in range(np.uint64(width)):
                own_value[to + x] = value[at + x]


@kernel
def _reads_every_y(code: _Code, first: int, width: int) -> bool:
    """Whether an instruction from the `first` on reads y at other points than the first of each row."""
    if not ROW_LEAST <= width <= BLOCK:
        return True
    for at in range(first, code.shape[0]):
        op, of_level = code[at, ops.CODE], code[at, ops.X] == ops.LEVEL
        if of_level and (op < ops.COORDINATE or op > ops.ABOVE):
            return True
        in_rows = code[at, ops.IN_ROWS] and op in (ops.GRADIENT3, ops.VALUE3, ops.SIMPLEX3)
        if (code[at, ops.Y] == ops.LEVEL or code[at, ops.Z] == ops.LEVEL) and not in_rows:
            return True
    return False


@kernel
def _level(y: float, count: int, stride: int, places: _Doubles) -> None:
    for i in range(0, count, stride):
        places[ops.LEVEL, i] = y


@kernel
def _place(values: _Floats, limit: np.float32, listed: _Code, width: int, plane: _Floats) -> None:
    """Write the densities of listed rows to where they belong in their plane."""
    for i in range(listed.size):
        at, to = np.uint64(i * width), np.uint64(listed[i] * width)
        for x in range(np.uint64(width)):
            value = values[at + x] if values[at + x] > -limit else -limit
            plane[to + x] = value if values[at + x] < limit else limit


@kernel
def _columns(start: int, width: int, low: _Doubles, step: float, count: int, x: _Doubles, z: _Doubles) -> None:
    """Write the coordinates of a slab that begins `start` points into its plane."""
    row, place = start // width, start % width
    for i in range(count):
        x[i], z[i] = low[0] + step * place, low[2] + step * row
        place += 1
        if place == width:
            row, place = row + 1, 0


@spliced
def _execute(
    code: _Code,
    at: int,
    numbers: _Doubles,
    keys: _Words,
    n: int,
    places: _Doubles,
    values: _Floats,
    fractions: _Floats,
    words: _Words,
    width: int,
) -> None:
    op, out = code[at, ops.CODE], code[at, ops.OUT]
    if ops.COORDINATE_LAST < op <= ops.ARITHMETIC_LAST:
        combine(code, at, n, width > 0, numbers, places, values)
        return
    constants = numbers[code[at, ops.NUMBERS] :]
    x, y, z = places[code[at, ops.X], :n], places[code[at, ops.Y], :n], places[code[at, ops.Z], :n]
    if op <= ops.COORDINATE_LAST:
        move(op, x, y, z, values[code[at, ops.A], :n], constants, places[out, :n])
    elif op <= ops.SHAPE_LAST:
        distances(op, x, y, z, constants, values[out, :n])
    else:
        its_width, below = width if code[at, ops.IN_ROWS] else 0, values[code[at, ops.B], :n]
        _noise(op, x, y, z, constants, keys[at], below, values[out, :n], fractions, words, its_width)


@spliced
def _noise(
    op: int,
    x: _Doubles,
    y: _Doubles,
    z: _Doubles,
    numbers: _Doubles,
    keys: _Words,
    below: _Floats,
    out: _Floats,
    fractions: _Floats,
    words: _Words,
    width: int,
) -> None:
    """Write below + amplitude * noise, or for `random` the numbers of cells x, y, z: arrays (n,)."""
    if op == ops.RANDOM:
        white(x, y, z, keys, out)
    elif op <= ops.VALUE3:
        add_blended(op, x, y, z, numbers, keys, below, out, fractions, words, width)
    elif op == ops.SIMPLEX2:
        add_simplex2(x, y, z, numbers, keys, below, out, fractions, words, width)
    elif op == ops.SIMPLEX3:
        add_simplex3(x, y, z, numbers, keys, below, out, fractions, words, width)
    elif op == ops.CELLULAR2:
        add_cellular2(x, y, z, numbers, keys, below, out, fractions, words, width)
    else:
        add_cellular3(x, y, z, numbers, keys, below, out, fractions, words, width)


@kernel
def _clamp(values: _Floats, limit: np.float32, out: _Floats) -> None:
    for i in range(out.size):
        value = values[i] if values[i] > -limit else -limit
        out[i] = value if values[i] < limit else limit
