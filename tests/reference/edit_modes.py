"""A handful of edits, folded and read under whatever mode of Numba the environment asks for.

    NUMBA_DISABLE_JIT=1 python -m tests.reference.edit_modes

prints one line of JSON: which mode it was, as seen by a kernel, and a digest of all bricks and of what a chunk reads.
"""

import hashlib
import json
import sys
import warnings
from itertools import product

import numba
import numpy as np

from chunkserver.edits import Edit
from chunkserver.edits.pyramid import halve
from chunkserver.edits.reading import apply
from tests.reference.modes import bounds_are_checked
from tests.strokes import OPS, SHAPES, delta_of, no_bricks, op_of, shape_of

SEED = 8
SAMPLES = (19, 17, 18)


def waves(box) -> np.ndarray:
    """Return a field without libm: the same bits everywhere."""
    x, y, z = (np.arange(low, high + 1) for low, high in zip(*box, strict=True))
    rough = (x[None, None, :] * 7 + z[None, :, None] * 13) % 32 / 8
    return np.ascontiguousarray(y[:, None, None] * 0.75 + rough - 2, np.float32)


def edits_digest() -> str:
    """Return a digest of what strokes of every op and shape make."""
    rng, digest = np.random.default_rng(SEED), hashlib.sha256()
    strokes = [op_of(rng, op, (0, 0, 0)) | shape_of(rng, shape, (0, 0, 0), 2.0) for op, shape in product(OPS, SHAPES)]
    edit = Edit.of([*strokes, delta_of(rng, (-2, -1, 0), (3, 2, 4))])
    bricks = no_bricks(lods=4).apply([edit], 1, waves)
    for key, brick in sorted(bricks, key=lambda pair: pair[0]):
        digest.update(repr((key, brick.low, brick.high)).encode() + brick.deltas.tobytes())
    for lod in range(2):
        density = np.full(SAMPLES, 0.1, np.float32)
        apply(density, bricks.arena.deltas, bricks.read(lod, (-9, -8, -7), SAMPLES))
        digest.update(density.tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    # Plain NumPy numbers say so when a product of uint64 wraps, as it is meant to.
    warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)
    report = {
        "compiled": isinstance(halve, numba.core.registry.CPUDispatcher),
        "bounds_checked": bounds_are_checked(),
        "digest": edits_digest(),
    }
    json.dump(report, sys.stdout)
