"""Smooth surfaces: no triangle is turned over, its own normal agrees with those that its vertices were given."""

import json

import numpy as np
import pytest

from chunkserver.recipe import WorldRecipe, builtin, canonical
from tests.worlds import chunk_mesh, keys

DEGREES_MAX = 90.0
"""Between a triangle and the mean of its vertices' normals, where relief is as fine as four steps."""
TURNED_MAX = {"relief": 1e-4}
"""Share of triangles beyond that. Of `relief` at LOD 0 there are 0 to 4 in 60,000, seed by seed."""


def relief() -> str:
    """Return the built-in planet without its caves, whose mouths have sharp rims."""
    return canonical(json.loads(builtin("planet"))["a"])


WORLDS = {
    "sphere": (builtin("sphere"), 25),
    "hills": (builtin("hills"), 60),
    "planet": (builtin("planet"), DEGREES_MAX),
    "relief": (relief(), DEGREES_MAX),
    "caves": (builtin("caves"), 70),
}
BOXES = {0: ((3, -2, -2), (7, 2, 2)), 1: ((2, -1, -1), (4, 1, 1))}
COARSE = ((-2,) * 3, (2,) * 3)


def triangle_angles(mesh):
    """Return the angle, in degrees, between each triangle and the mean of its vertices' normals."""
    points = mesh.positions[:, :3].astype(float)
    a, b, c = (points[mesh.triangles[:, i]] for i in range(3))
    across, given = np.cross(b - a, c - a), mesh.normals[mesh.triangles, :3].astype(float).sum(axis=1)
    cosine = np.einsum("ij,ij->i", across, given) / np.linalg.norm(across, axis=1) / np.linalg.norm(given, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize(
    ("name", "lod"),
    [("sphere", 0), ("caves", 0)]
    + [("hills", lod) for lod in range(5)]
    + [("relief", lod) for lod in range(2)]
    + [("planet", lod) for lod in range(2, 5)],
)
def test_no_triangle_is_turned_over(name, lod):
    source, degrees_max = WORLDS[name]
    low, high = BOXES[lod] if name == "relief" else COARSE
    meshes = [chunk_mesh(WorldRecipe(7, source), key, 32, "float32") for key in keys(lod, low, high)]
    angles = np.concatenate([triangle_angles(mesh) for mesh in meshes])
    assert len(angles) > 5000
    assert (angles >= degrees_max).mean() <= TURNED_MAX.get(name, 0)
