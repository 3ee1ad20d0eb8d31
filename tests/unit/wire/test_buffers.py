from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from chunkserver.errors import WireError
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.wire import Encoding, encode
from chunkserver.wire.buffers import bounds
from tests.unit.wire.meshes import PLACEMENT, strip

FOUR = strip(4)


def changed(**arrays: Any) -> Mesh:
    return replace(FOUR, **arrays)


@pytest.mark.parametrize("encoding", [Encoding(), Encoding("glb")])
@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (changed(triangles=np.array([[0, 1, 4]], np.uint16)), "a triangle names vertex 4 of 4"),
        (changed(normals=strip(4, "float32").normals), "normals is"),
        (changed(normals=strip(5).normals), "normals is"),
        (changed(positions=FOUR.positions.astype(np.int32)), "positions is"),
        (changed(positions=np.ascontiguousarray(FOUR.positions[:, :3])), "positions is"),
        (changed(positions=np.asfortranarray(FOUR.positions)), "positions is"),
        (changed(triangles=FOUR.triangles.astype(np.int64)), "triangles is"),
        (changed(triangles=FOUR.triangles.reshape(-1)[None]), "triangles is"),
        (changed(positions=FOUR.positions[:0]), "0 vertices"),
        (changed(triangles=FOUR.triangles[:0]), "0 triangles"),
        (changed(content="rock"), "a mesh of rock has no surface, but 4 vertices"),
    ],
)
def test_a_mesh_that_cannot_be_written(mesh: Mesh, message: str, encoding: Encoding):
    with pytest.raises(WireError, match=f"^{message}"):
        encode(mesh, PLACEMENT, encoding)


def test_the_profile_wants_its_normals():
    with pytest.raises(WireError, match=r"^normals is"):
        encode(FOUR, PLACEMENT, Encoding(profile="f32"))


def test_counts_are_limited():
    # Never touched: the operating system gives these pages no memory.
    with pytest.raises(WireError, match=rf"^{2**24 + 1} vertices"):
        encode(changed(positions=np.empty((2**24 + 1, 4), np.uint16)), PLACEMENT)
    with pytest.raises(WireError, match=rf"^{2**25 + 1} triangles"):
        encode(changed(triangles=np.empty((2**25 + 1, 3), np.uint16)), PLACEMENT)


@pytest.mark.parametrize("encoding", [Encoding(), Encoding(profile="f32"), Encoding("glb")])
def test_an_empty_mesh_may_have_either_kind_of_normals(encoding: Encoding):
    other = replace(EMPTY["air"], normals=np.empty((0, 3), np.float32))
    assert encode(EMPTY["air"], PLACEMENT, encoding) == encode(other, PLACEMENT, encoding)


@pytest.mark.parametrize("count", [3, 4, 17, 1000])
def test_bounds(count, rng):
    positions = rng.integers(0, 1 << 16, (count, 4)).astype(np.uint16)
    low, high = bounds(replace(strip(count), positions=positions))
    assert low == [min(column) for column in positions[:, :3].T.tolist()]
    assert high == [max(column) for column in positions[:, :3].T.tolist()]
