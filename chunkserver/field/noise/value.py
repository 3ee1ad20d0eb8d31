"""Value noise: a random number at each lattice corner, blended over the square or cube between them.

The blend is the quintic one of gradient noise; it makes each value a mean of the corners' values, so it stays in their
range.
"""

import numpy as np

from chunkserver.field.noise.lattice import ROUND_2, ROW, ZERO, Floats, Words, stir, unit
from chunkserver.field.noise.lines import HIGH, LINE_Y, LOW, X_BLEND, X_HIGH, X_LOW, mix
from chunkserver.kernel import inlined, kernel


@kernel
def value_line2(n: int, fractions: Floats, words: Words, into: int) -> None:
    """Write a line, as `lines` defines it, of value noise of the plane."""
    line = fractions[into:]
    for i in range(n):
        line[i] = _edge(words[i + X_LOW], words[i + X_HIGH], words[i + LOW], fractions[i + X_BLEND])
        line[i + ROW] = ZERO


@kernel
def value_line3(n: int, fractions: Floats, words: Words, into: int) -> None:
    """Write a line, as `lines` defines it, of value noise in space."""
    line = fractions[into:]
    for i in range(n):
        x0, x1, blend = words[i + X_LOW], words[i + X_HIGH], fractions[i + X_BLEND]
        low, high = _edge(x0, x1, words[i + LOW], blend), _edge(x0, x1, words[i + HIGH], blend)
        line[i] = mix(low, high, fractions[i + LINE_Y + ROW])
        line[i + ROW] = ZERO


@inlined
def _edge(x0: np.uint32, x1: np.uint32, across: np.uint32, blend: np.float32) -> np.float32:
    """Return the value between two corners along x; `across` is the sum of the other axes' hashes."""
    return mix(unit(stir(np.uint32(x0 + across), ROUND_2)), unit(stir(np.uint32(x1 + across), ROUND_2)), blend)
