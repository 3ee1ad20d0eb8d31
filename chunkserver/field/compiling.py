"""Compiling the field's kernels without a recipe, so that `chunkserver.worker` can do it in two processes at once."""

from typing import Final

import numpy as np

from chunkserver.field import ops
from chunkserver.field.interpreter import NONE_READY, WORK_COLUMNS, run
from chunkserver.field.intervals import bound
from chunkserver.field.noise.cellular import add_cellular2, add_cellular3
from chunkserver.field.noise.lattice import scratch
from chunkserver.field.noise.simplex3 import add_simplex3
from chunkserver.field.skipping import compile_skipping
from chunkserver.field.tape import INPUTS

_CODE: Final = np.empty((0, ops.COLUMNS), np.int32)
_STARTS: Final = np.zeros(2, np.int32)
_NUMBERS: Final = np.zeros(ops.NUMBERS_LONGEST)
_KEYS: Final = np.empty((0, 3), np.uint32)
_NO_REGISTERS: Final = np.empty(0, np.int32)
_NONE_LISTED: Final = np.empty(0, np.int32)
"""A tape without an instruction."""


def compile_interpreter() -> None:
    """Compile, or load from disk, what samples chunks: half of all compiling."""
    tape = _CODE, _STARTS, _NUMBERS, _KEYS, _NO_REGISTERS, _NO_REGISTERS, 0
    work = np.empty((0, WORK_COLUMNS), np.int32)
    places, values, density = np.zeros((1, INPUTS, 1)), np.zeros((1, 1, 1), np.float32), np.empty((1, 1), np.float32)
    run(*tape, np.zeros(3), 1.0, 1, NONE_READY, work, _NONE_LISTED, places, values, *scratch(), density)


def compile_beside() -> None:
    """Compile meanwhile the noises that the interpreter comes to last, and the bounds, which it does not need."""
    at, keys = np.zeros(1), np.zeros(3, np.uint32)
    below, out = np.zeros((2, 1), np.float32)
    for add_noise in (add_simplex3, add_cellular2, add_cellular3):
        add_noise(at, at, at, _NUMBERS, keys, below, out, *scratch(), 0)
    low, high = np.zeros((2, 1, 1), np.float32)
    places, spread, failed = np.zeros((4, INPUTS, 1)), np.zeros((1, 1)), np.zeros(1, np.int32)
    bound(_CODE, _NUMBERS, False, places, np.zeros((1, 1), np.float32), failed, low, high, spread)
    compile_skipping()
