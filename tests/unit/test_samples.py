"""What `Samples` refuses: it is the one door through which densities come to a mesher."""

import numpy as np
import pytest

from chunkserver.errors import BadParameter
from chunkserver.grid import ChunkShape
from chunkserver.samples import Samples

GOOD = np.zeros((19, 19, 19), np.float32)


def test_keeps_the_array_itself():
    assert Samples(ChunkShape(16), GOOD).density is GOOD


@pytest.mark.parametrize(
    ("density", "named"),
    [
        (GOOD[1:], "(18, 19, 19)"),
        (GOOD[:17, :17, :17].copy(), "(17, 17, 17)"),
        (np.zeros((19, 19), np.float32), "(19, 19)"),
        (np.zeros((35, 35, 35), np.float32), "(35, 35, 35)"),
        (GOOD.astype(np.float64), "float64"),
        (GOOD.astype(np.int32), "int32"),
        (GOOD.astype(">f4"), ">f4"),
        (np.asfortranarray(GOOD), "C order"),
        (np.zeros((19, 19, 38), np.float32)[:, :, ::2], "C order"),
    ],
)
def test_names_what_is_wrong_with_an_array(density, named):
    with pytest.raises(BadParameter) as refused:
        Samples(ChunkShape(16), density)
    assert named in refused.value.message


@pytest.mark.parametrize("shape", [ChunkShape(8), ChunkShape(17), ChunkShape(128), ChunkShape(16, 0)])
def test_refuses_a_shape_that_is_not_built(shape):
    with pytest.raises(BadParameter, match=r"cells is|apron is"):
        Samples(shape, np.zeros((shape.samples,) * 3, np.float32))
