"""`extract`: which meshers there are, and what it refuses."""

import numpy as np
import pytest

from chunkserver.errors import BadParameter
from chunkserver.grid import ChunkShape
from chunkserver.mesher import MESHER_DEFAULT, MESHERS, extract, table
from chunkserver.samples import Samples
from tests.worlds import SMALLEST, white_noise


def test_the_default_is_built():
    assert MESHER_DEFAULT in MESHERS
    assert MESHERS[MESHER_DEFAULT].apron == 1


def test_a_mesher_that_is_not_built_is_named(rng):
    with pytest.raises(BadParameter, match=r"'dual'.*marching-cubes") as refused:
        extract(Samples(SMALLEST, white_noise(rng, SMALLEST.samples)), "dual")
    assert refused.value.values == {"mesher": "dual"}


def test_too_small_an_apron_is_named(rng, monkeypatch):
    greedy = MESHERS[MESHER_DEFAULT]._replace(apron=2)
    monkeypatch.setitem(table.MESHERS, "greedy", greedy)
    with pytest.raises(BadParameter, match="apron is 1; greedy needs 2") as refused:
        extract(Samples(SMALLEST, white_noise(rng, SMALLEST.samples)), "greedy")
    assert refused.value.values == {"apron": 1}
    wide = ChunkShape(16, 2)
    assert len(extract(Samples(wide, white_noise(rng, wide.samples)), "greedy").triangles)


def test_every_mesher_gives_empty_meshes():
    air = np.ones((SMALLEST.samples,) * 3, np.float32)
    for mesher in MESHERS:
        for normals in ("int8", "float32"):
            for content, density in (("air", air), ("rock", -air)):
                mesh = extract(Samples(SMALLEST, density), mesher, normals)
                assert mesh.content == content
                assert mesh.is_empty
                assert len(mesh.positions) == len(mesh.normals) == len(mesh.triangles) == 0
