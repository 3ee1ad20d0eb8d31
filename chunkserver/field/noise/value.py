"""Value noise: a random number at each lattice corner, blended over the square or cube between them.

A cell is the unit square or cube around a whole number, so corners lie half-way between whole numbers. The blend is the
quintic one of gradient noise; it makes each value a mean of the corners' values, so it stays in their range.
"""

import numpy as np

from chunkserver.field.noise.lattice import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BLOCK,
    HALF,
    HERE,
    ROUND_2,
    Doubles,
    Floats,
    Words,
    axis_hashes,
    mix,
    quintic,
    split2,
    split3,
    stir,
    unit,
)
from chunkserver.kernel import inlined, kernel


@kernel
def add_value2(
    x: Doubles,
    y: Doubles,  # noqa: ARG001 - all noises have one signature
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
) -> None:
    """Write below + amplitude * 2-D value noise in [-1, 1], mean 0. Arguments: see the package."""
    amplitude, key_x, key_z = np.float32(numbers[0]), keys[0], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        split2(x[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], HERE, AXIS_X, key_x)
            z0, z1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], HERE, AXIS_Z, key_z)
            blend_x = quintic(np.float32(fractions[i] + HALF))
            noise = mix(_edge(x0, x1, z0, blend_x), _edge(x0, x1, z1, blend_x), quintic(fractions[i + BLOCK] + HALF))
            outs[i] = belows[i] + np.float32(amplitude * noise)


@kernel
def add_value3(
    x: Doubles,
    y: Doubles,
    z: Doubles,
    numbers: Doubles,
    keys: Words,
    below: Floats,
    out: Floats,
    fractions: Floats,
    words: Words,
) -> None:
    """Write below + amplitude * 3-D value noise in [-1, 1], mean 0. Arguments: see the package."""
    amplitude, key_x, key_y, key_z = np.float32(numbers[0]), keys[0], keys[1], keys[2]
    for start in range(0, out.size, BLOCK):
        stop = min(start + BLOCK, out.size)
        split3(x[start:stop], y[start:stop], z[start:stop], numbers, fractions, words)
        belows, outs = below[start:stop], out[start:stop]
        for i in range(stop - start):
            x0, x1 = axis_hashes(words[i], words[i + BLOCK], HERE, AXIS_X, key_x)
            y0, y1 = axis_hashes(words[i + 2 * BLOCK], words[i + 3 * BLOCK], HERE, AXIS_Y, key_y)
            z0, z1 = axis_hashes(words[i + 4 * BLOCK], words[i + 5 * BLOCK], HERE, AXIS_Z, key_z)
            blend_x, blend_y = quintic(fractions[i] + HALF), quintic(fractions[i + BLOCK] + HALF)
            low = mix(_edge(x0, x1, np.uint32(y0 + z0), blend_x), _edge(x0, x1, np.uint32(y1 + z0), blend_x), blend_y)
            high = mix(_edge(x0, x1, np.uint32(y0 + z1), blend_x), _edge(x0, x1, np.uint32(y1 + z1), blend_x), blend_y)
            noise = mix(low, high, quintic(fractions[i + 2 * BLOCK] + HALF))
            outs[i] = belows[i] + np.float32(amplitude * noise)


@inlined
def _edge(x0: np.uint32, x1: np.uint32, across: np.uint32, blend: np.float32) -> np.float32:
    """Return the value between two corners along x; `across` is the sum of the other axes' hashes."""
    return mix(unit(stir(np.uint32(x0 + across), ROUND_2)), unit(stir(np.uint32(x1 + across), ROUND_2)), blend)
