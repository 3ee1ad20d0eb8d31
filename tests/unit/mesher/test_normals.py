"""The normal between a fine corner and its coarse twin: of both gradients, and what it is where they cancel."""

import numpy as np
import pytest

from chunkserver.kernel import kernel
from chunkserver.mesher import normals

SIDE = 3
MIDDLE = SIDE * SIDE + SIDE + 1


@kernel
def _twin_normal(fine, coarse):
    return normals.twin_normal(fine, MIDDLE, SIDE, SIDE * SIDE, coarse, MIDDLE, SIDE, SIDE * SIDE)


def slope(x, y, z):
    """Return 27 samples that rise so much a cell along each axis, flat."""
    up, back, right = np.indices((SIDE,) * 3) - 1
    return (x * right + y * up + z * back).astype(np.float32).reshape(-1)


def test_it_is_that_of_both_gradients_a_voxel():
    """Coarse cells are two voxels wide: a slope of 2 a coarse cell is one of 1 a fine cell."""
    found = _twin_normal(slope(1, 0, -2), slope(2, 8, 0))
    assert found == pytest.approx(np.array([4, 8, -4]) / np.sqrt(96), abs=1e-15)


@pytest.mark.parametrize("fine", [(0, 0, 0), (1, 0, 0), (0, -3, 0), (2, 1, -5)])
def test_it_is_up_where_they_cancel(fine):
    assert _twin_normal(slope(*fine), slope(*(-2 * part for part in fine))) == (0.0, 1.0, 0.0)
