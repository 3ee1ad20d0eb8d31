"""Rows of bits: the vector comparison against Python's, and lists of runs against what NumPy says is crossed."""

from itertools import product

import numpy as np
import pytest

from chunkserver import kernel as compiler
from chunkserver.grid import CELLS_BUILT, ChunkShape
from chunkserver.kernel import LANES, kernel, lanes_below
from chunkserver.mesher.rows import (
    ALL_AIR,
    ALL_ROCK,
    FLAGS,
    MIXED,
    RUN_BITS,
    RUN_CELLS,
    SLOT_X,
    list_runs,
    pack,
    runs_of,
    slot_bits,
)
from tests.worlds import GRIDS

HARD = np.array([0.0, -0.0, 1e-45, -1e-45, 65536, -65536, np.inf, -np.inf, np.nan, -1, 1, -1e-38], np.float32)


@kernel
def _below(values, at, limit):
    return lanes_below(values, at, limit)


@pytest.mark.parametrize("limit", [0.0, -0.0, 1e-45, -1.0])
def test_the_vector_comparison_is_pythons(limit, rng):
    values, limit = rng.choice(HARD, 500), np.float32(limit)
    for at in map(np.uint64, range(500 - LANES + 1)):
        expected = sum(int(value < limit) << lane for lane, value in enumerate(values[int(at) :][:LANES]))
        assert _below(values, at, limit) == expected == compiler._lanes_below(values, at, limit)


def packed(density, shape):
    rows = np.empty((shape.corners, shape.corners, runs_of(shape.cells)), np.uint64)
    return rows, pack(density.reshape(-1), shape.samples, shape.apron, rows.reshape(-1))


def inner(density, shape):
    corners = slice(shape.apron, shape.apron + shape.corners)
    return density[corners, corners, corners] < 0


@pytest.mark.parametrize(("cells", "kind", "apron"), [*product(CELLS_BUILT, GRIDS, (1, 2))])
def test_pack(cells, kind, apron, rng):
    """The last row ends where the apron does: whatever is read beyond a row is beyond the array there."""
    shape = ChunkShape(cells, apron)
    density = GRIDS[kind](rng, shape.samples)
    rows, found = packed(density, shape)
    rock, run = inner(density, shape), min(cells, RUN_CELLS)
    for number in range(runs_of(cells)):
        places = np.uint64(1) << np.arange(run + 1, dtype=np.uint64)
        assert np.array_equal(rows[:, :, number], rock[:, :, number * run :][:, :, : run + 1] @ places)
    assert found == (ALL_ROCK if rock.all() else MIXED if rock.any() else ALL_AIR)


@pytest.mark.parametrize("cells", CELLS_BUILT)
@pytest.mark.parametrize("place", [0, -1])
def test_one_corner_alone_is_mixed(cells, place):
    shape = ChunkShape(cells)
    density = np.full((shape.samples,) * 3, 1, np.float32)
    assert packed(density, shape)[1] == ALL_AIR
    assert packed(-density, shape)[1] == ALL_ROCK
    corner = shape.apron + place % shape.corners
    density[corner, corner, corner] = -1
    assert packed(density, shape)[1] == MIXED
    assert packed(-density, shape)[1] == MIXED


def listed(entries, bits):
    """Return (plane, slot in the plane) of every flag of the entries, in their order."""
    for entry in map(int, entries):
        flags, slot = entry & int(FLAGS), entry >> int(RUN_BITS)
        assert flags, "a run that is empty"
        for place in range(RUN_CELLS + 1):
            if flags >> place & 1:
                plane = 2 * bits + int(SLOT_X)
                at = slot + (place << int(SLOT_X))
                yield at >> plane, at & (1 << plane) - 1


@pytest.mark.parametrize(("cells", "kind"), [*product([16], GRIDS), (32, "smooth"), (64, "smooth")])
def test_what_is_crossed_is_listed_once(cells, kind, rng):
    shape, bits = ChunkShape(cells), slot_bits(cells)
    density = GRIDS[kind](rng, shape.samples)
    rows, _ = packed(density, shape)
    firsts = np.empty((*rows.shape, 3), np.uint64)
    edges, mixed = np.zeros(3 * rows.size + 1, np.uint64), np.zeros(rows.size + 1, np.uint64)
    ends = np.empty((shape.corners, 2), np.uint64)
    list_runs(rows.reshape(-1), shape.corners, bits, firsts.reshape(-1), edges, mixed, ends)
    rock = inner(density, shape)
    slot = np.indices(rock.shape) << np.array([0, bits + 2, 2])[:, None, None, None]
    expected = set()
    for axis, along in enumerate((2, 0, 1)):
        crossed = np.diff(rock, axis=along)
        expected |= {(y, z + x + axis) for y, z, x in slot[:, *np.nonzero(crossed)].T.tolist()}
    count = int(ends[-1, 0])
    found = list(listed(edges[: np.count_nonzero(edges[:-1] & FLAGS)], bits))
    assert len(found) == count == len(expected)
    assert set(found) == expected
    corners = [rock[y : y + cells, z : z + cells, x : x + cells] for y, z, x in product((0, 1), repeat=3)]
    assert int(ends[-1, 1]) == np.count_nonzero(np.any(corners, axis=0) & ~np.all(corners, axis=0))
