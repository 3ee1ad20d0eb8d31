"""Samples near the surface: those whose value can matter are worked out, of the others the sign alone is known.

    region   12 x 12 x 12 samples bounds of the field: all air, all rock, or which branches of it are left (`programs`)
    patch    2 x 2 x 2 samples    the field at its middle, and how much it can change up to them: air, rock, open
    row      of samples along x   of open patches, and of samples that a vertex's place or normal reads: worked out

A mesh reads the signs of all samples, but values only on crossed edges and one step around. So patches that are known
to be air or rock are filled with one number of that sign, and the mesh has the same bytes: see
`tests/property/test_skipping.py`. Which samples are read is found from the signs, once all of them are known. Rows are
worked out whole: noise of a row costs less than half of that of as many points anywhere.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.flatten import Flat
from chunkserver.field.interpreter import NONE_READY, SLAB_POINTS, WORK_COLUMNS, run
from chunkserver.field.intervals import bounds
from chunkserver.field.noise.lattice import scratch
from chunkserver.field.patches import (
    OPEN,
    PATCH,
    PATCHES,
    REACH,
    REGION,
    ROCK,
    WORD_BITS,
    judge,
    list_work,
    miss,
    settle,
)
from chunkserver.field.points import run_box
from chunkserver.field.programs import PROGRAMS_MAX

WORTH: Final = 25.0
"""Nanoseconds a sample must cost for this to pay: finding out what matters takes 3 ns a sample of the chunk or more."""
SETTLED_MIN: Final = 0.25
"""The share of regions that must be all air or all rock, or else the whole chunk is sampled: patches alone leave out
too few rows."""
FILL: Final = np.float32(1)
"""The density, but for its sign, of samples that are not worked out."""

_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Code = NDArray[np.int32]
_Bytes = NDArray[np.uint8]


def run_near_surface(flat: Flat, low: _Doubles, step: float, side: int, apron: int, faces: int) -> _Floats:
    """Return the densities of a cube of lattice points, worked out where a mesh reads them: (side, side, side) float32.

    low: x, y, z of the first one, voxels. apron: samples around the corners. faces: mask of faces, bits as in
        `samples.Samples`: their corners, and one step around, are worked out whatever they are.
    """
    patches = -(-side // PATCH)
    regions = _judged(flat, low, step, -(-side // REGION))
    if (regions.kinds <= ROCK).mean() < SETTLED_MIN:
        return run_box(flat.tape, low, step, (side, side, side))
    near = (regions.kinds == OPEN).any(axis=2).view(np.uint8)
    middles = np.empty((patches, patches * patches), np.float32)
    if near.any():
        _Box(flat, regions, low + REACH * step, PATCH * step, middles).work_out(near, PATCHES, 1)
    density = np.empty((side, side * side), np.float32)
    wanted = np.empty((patches, patches), np.uint8)
    rows = np.empty((3, PATCH * patches), np.float32)
    settle(regions.kinds, regions.spread, middles, faces, apron + 2, side, FILL, rows, wanted, density.reshape(-1))
    box = _Box(flat, regions, low, step, density)
    box.work_out(wanted, PATCH, PATCHES)
    rock, ends = np.empty((2, side, side, -(-side // WORD_BITS)), np.uint64)
    if miss(density.reshape(-1), apron, wanted, rock, ends):
        box.work_out(wanted, PATCH, PATCHES)
    return density.reshape(side, side, side)


def compile_skipping() -> None:
    """Compile, or load from disk, the kernels of this file: nothing is looked at, of a box without a point."""
    code, keys, starts = np.empty((1, ops.COLUMNS), np.int32), np.empty((1, 3), np.uint32), np.empty(2, np.int32)
    numbers, reads, low = np.zeros(ops.NUMBERS_LONGEST), np.full((1, 6), -1, np.int32), np.empty((1, 0), np.float32)
    none, kinds = np.empty(0, np.int32), np.empty((0, 0, 0), np.uint8)
    programs, chosen = np.empty((PROGRAMS_MAX, 1), np.uint8), np.empty((0, 0), np.int32)
    spread, states = np.empty((1, 0)), (kinds, chosen, programs, programs[0], code, keys, starts)
    judge(code, numbers, reads, 0, 0, none, low, low, spread, code, keys, *states)
    wanted = np.empty((0, 0), np.uint8)
    list_work(wanted, 1, chosen, 1, 0, 0, 1, np.empty((0, WORK_COLUMNS), np.int32), none)
    density = np.empty((0, 0), np.float32)
    flat, words = np.empty(0, np.float32), np.empty((0, 0, 1), np.uint64)
    settle(kinds, np.empty((0, 0, 0)), density, 0, 0, 0, FILL, np.empty((3, 0), np.float32), wanted, flat)
    miss(flat, 0, wanted, words, words)


class _Regions(NamedTuple):
    """What is known of each region, (y, z, x): uint8 kinds, float64 spread of the density.

    chosen: int32 programs of rows of regions, (y, z). programs: how many there are. code, keys, starts: of all of
    them, as `interpreter.run` wants them.
    """

    kinds: _Bytes
    spread: _Doubles
    chosen: _Code
    programs: int
    code: _Code
    keys: NDArray[np.uint32]
    starts: _Code


def _judged(flat: Flat, low: _Doubles, step: float, regions: int) -> _Regions:
    tape, n, instructions = flat.kept, regions**3, len(flat.kept.code)
    along = REGION * step * np.arange(regions)
    corners = np.empty((3, regions, regions, regions))
    corners[0], corners[1], corners[2] = low[0] + along, low[1] + along[:, None, None], low[2] + along[:, None]
    lows = corners.reshape(3, n)
    found = bounds(tape, lows, lows + (REGION - 1) * step, REACH * step)
    shape = regions, regions, regions
    kinds, chosen = np.empty(shape, np.uint8), np.empty(shape[1:], np.int32)
    room = PROGRAMS_MAX * instructions
    code, keys = np.empty((room, ops.COLUMNS), np.int32), np.empty((room, 3), np.uint32)
    starts = np.empty(PROGRAMS_MAX + 1, np.int32)
    known = np.empty((PROGRAMS_MAX + 1, instructions), np.uint8)  # the last row is scratch
    own = flat.tape.code, flat.tape.keys
    of_tape = tape.code, tape.numbers, tape.reads, tape.columns, tape.result
    count = judge(*of_tape, *found, *own, kinds, chosen, known, known[-1], code, keys, starts)
    spread = found.spread[tape.result].reshape(shape)
    written = starts[count]
    return _Regions(kinds, spread, chosen, count, code[:written], keys[:written], starts)


class _Box:
    """A cube of lattice points whose densities are worked out block by block, density: (side, side * side)."""

    def __init__(self, flat: Flat, regions: _Regions, low: _Doubles, step: float, density: _Floats) -> None:
        self._tape, self._regions, self._density = flat.tape, regions, density
        self._low, self._step = low, step
        side = len(density)
        self._points = SLAB_POINTS // side * side
        self._places = np.empty((2, flat.tape.places, self._points))
        self._values = np.empty((2, flat.tape.values, self._points), np.float32)
        self._ready = NONE_READY

    def work_out(self, wanted: _Bytes, size: int, of_region: int) -> None:
        """Write the densities of wanted rows of blocks, (y, z); `size`: points a side, `of_region`: blocks a region."""
        tape, regions, side = self._tape, self._regions, len(self._density)
        slab_blocks = self._points // side // size
        slabs = -(-len(wanted) // slab_blocks)
        work = np.empty((slabs * len(wanted) * regions.programs, WORK_COLUMNS), np.int32)
        listed = np.empty(len(wanted) * side, np.int32)
        pieces = list_work(wanted, size, regions.chosen, of_region, regions.programs, side, slab_blocks, work, listed)
        program = regions.code, regions.starts, tape.numbers, regions.keys
        shared = tape.shared_places, tape.shared_values
        registers = self._places, self._values
        box = self._low, self._step
        todo = work[:pieces], listed
        run(*program, *shared, tape.result, *box, side, self._ready, *todo, *registers, *scratch(), self._density)
        self._ready = 0 if slabs == 1 and pieces else NONE_READY
