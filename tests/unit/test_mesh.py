"""The two meshes without a surface."""

import numpy as np
import pytest

from chunkserver.mesh import EMPTY, Mesh


@pytest.mark.parametrize("content", ["air", "rock"])
def test_empty_meshes_are_values(content):
    mesh = EMPTY[content]
    assert mesh.content == content
    assert mesh.is_empty
    arrays = (mesh.positions, mesh.normals, mesh.triangles)
    assert [array.shape for array in arrays] == [(0, 4), (0, 4), (0, 3)]
    assert [array.dtype for array in arrays] == [np.dtype(kind) for kind in ("uint16", "int8", "uint16")]


def test_a_mesh_with_a_surface_is_not_empty():
    empty = EMPTY["air"]
    assert set(EMPTY) == {"air", "rock"}
    assert not Mesh("surface", empty.positions, empty.normals, empty.triangles).is_empty
