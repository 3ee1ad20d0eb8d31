"""A handful of meshes, built under whatever mode of Numba the environment asks for.

    NUMBA_DISABLE_JIT=1 python -m tests.reference.modes

prints one line of JSON: which mode it was, as seen by a kernel, and a digest of the meshes.
"""

import hashlib
import json
import sys
import warnings

import numba
import numpy as np

from chunkserver.kernel import kernel
from tests.worlds import SMALLEST, extremes, grid_mesh, integers

SEED = 20


@kernel
def _read(row, place):
    return row[place]


def bounds_are_checked() -> bool:
    """Return whether a kernel that reads past the end of an array raises."""
    row = np.zeros(1)
    try:
        _read(row[:0], 0)
    except IndexError:
        return True
    return False


def meshes_digest() -> str:
    """Return a digest of meshes of the grids that are hardest, with both kinds of normals."""
    rng, digest = np.random.default_rng(SEED), hashlib.sha256()
    meshes = (
        grid_mesh(integers(rng, SMALLEST.samples)),
        grid_mesh(integers(rng, SMALLEST.samples), "float32"),
        grid_mesh(extremes(rng, SMALLEST.samples)),
    )
    for mesh in meshes:
        for array in (mesh.positions, mesh.normals, mesh.triangles):
            digest.update(array.tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    # Plain NumPy numbers say so when a product of uint64 wraps, as it is meant to.
    warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)
    report = {
        "compiled": isinstance(_read, numba.core.registry.CPUDispatcher),
        "bounds_checked": bounds_are_checked(),
        "digest": meshes_digest(),
    }
    json.dump(report, sys.stdout)
