"""Running a tape from Python: over points, over a box of lattice points. Every point is worked out."""

import threading
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.interpreter import ALL, NONE_READY, SLAB_POINTS, run
from chunkserver.field.noise.lattice import scratch
from chunkserver.field.tape import INPUTS, Tape

Shape = tuple[int, int, int]
"""How many points: planes (y), rows (z), points of a row (x)."""


class _Scratch(threading.local):
    """Scratch memory of the noises, kept by each thread: it is in use only while the interpreter runs."""

    def __init__(self) -> None:
        self.rows = scratch()


_SCRATCH: Final = _Scratch()
_NOWHERE: Final = np.zeros(3)
_NONE_LISTED: Final = np.empty(0, np.int32)
SIZES_MAX: Final = 64
"""Numbers of points whose work is kept."""


def run_at(tape: Tape, places: NDArray[np.float64], values: NDArray[np.float32]) -> None:
    """Work out all registers at n points: what each instruction wrote, if the tape keeps them all.

    places: (1, coordinate registers, n), whose first three hold the points, x y z, voxels. values: (1, value registers,
        n) out.
    """
    n = places.shape[2]
    _run(tape, _NOWHERE, 1.0, 0, _once(n), places, values, np.empty((1, n), np.float32))


@lru_cache(maxsize=SIZES_MAX)
def _once(n: int) -> NDArray[np.int32]:
    """Return the work of n points in one slab."""
    return np.array([[0, n, 0, 0, 1, 0, ALL]], np.int32)


def densities_at(tape: Tape, step: float, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the densities at points: (n,) float32. points: (n, 3) float64. step: of the tape's level, voxels."""
    density, places = np.empty((1, len(points)), np.float32), np.empty((1, tape.places, SLAB_POINTS))
    values = np.empty((1, tape.values, SLAB_POINTS), np.float32)
    for start in range(0, len(points), SLAB_POINTS):
        slab = points[start : start + SLAB_POINTS]
        n = len(slab)
        places[0, :INPUTS, :n] = slab.T
        _run(tape, _NOWHERE, step, 0, _once(n), places, values, density[:, start : start + n])
    found: NDArray[np.float32] = density[0]
    return found


def run_box(tape: Tape, low: NDArray[np.float64], step: float, shape: Shape) -> NDArray[np.float32]:
    """Return the densities of a box of lattice points, (planes, rows, width) float32. low: x, y, z of the first one."""
    planes, rows, width = shape
    work, slab = _whole(planes, rows, width)
    places, values = np.empty((1, tape.places, slab)), np.empty((1, tape.values, slab), np.float32)
    density = np.empty((planes, rows * width), np.float32)
    _run(tape, low, step, rows, work, places, values, density)
    return density.reshape(shape)


@lru_cache(maxsize=SIZES_MAX)
def _whole(planes: int, rows: int, width: int) -> tuple[NDArray[np.int32], int]:
    """Return the work of all points of a box, slab by slab, and how many points the largest slab has.

    Slabs are whole rows, about equally many each.
    """
    of_slab = max(1, SLAB_POINTS // width)
    of_slab = -(-rows // -(-rows // of_slab))
    starts = range(0, rows, of_slab)
    counts = [(min(row + of_slab, rows) - row) * width for row in starts]
    pieces = [(row * width, count, 0, 0, planes, 0, ALL) for row, count in zip(starts, counts, strict=True)]
    return np.array(pieces, np.int32), counts[0]


def _run(
    tape: Tape,
    low: NDArray[np.float64],
    step: float,
    rows: int,
    work: NDArray[np.int32],
    places: NDArray[np.float64],
    values: NDArray[np.float32],
    density: NDArray[np.float32],
) -> None:
    """Run the tape as it is. The arguments are those of `interpreter.run`."""
    shared = tape.shared_places, tape.shared_values
    program = tape.code, tape.starts, tape.numbers, tape.keys
    run(
        *program,
        *shared,
        tape.result,
        low,
        step,
        rows,
        NONE_READY,
        work,
        _NONE_LISTED,
        places,
        values,
        *_SCRATCH.rows,
        density,
    )
