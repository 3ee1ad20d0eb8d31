"""Chunks as they are served, from the pipeline into the hands of others."""

import io
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
import pytest
import trimesh

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest, build_chunk
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.contract.test_wire_glb import issues
from tests.contract.test_wire_native_example import decode, metres

GLB: Final = Encoding("glb")
FAR: Final = 2**35 - 1
SPHERE_RADIUS: Final = 48
SPHERE_KEYS: Final = [ChunkKey(0, *key) for key in product(range(-2, 2), repeat=3)]


def chunk(name: str, key: ChunkKey, encoding: Encoding = GLB) -> Chunk:
    return build_chunk(ChunkRequest(WorldRecipe(7, builtin(name)), key, encoding=encoding))


def test_validator_has_nothing_to_say(tmp_path: Path):
    near = [ChunkKey(lod, x, y, 0) for lod in (0, 1, 4) for x, y in product((-1, 0), repeat=2)]
    far = [ChunkKey(0, FAR, -1, -FAR), ChunkKey(0, -FAR, -FAR, FAR), ChunkKey(20, 1, -1, 0)]
    chunks = [chunk(name, key) for name in BUILTINS for key in near + far]
    assert {one.content for one in chunks} == {"air", "rock", "surface"}
    for found in issues(tmp_path, [one.body for one in chunks]):
        assert (found["numErrors"], found["numWarnings"], found["numHints"]) == (0, 0, 0), found["messages"]


def test_trimesh_puts_the_sphere_together():
    parts = [
        trimesh.load_scene(io.BytesIO(one.body), file_type="glb", process=False).to_mesh()
        for one in (chunk("sphere", key) for key in SPHERE_KEYS)
        if one.content == "surface"
    ]
    soup = np.concatenate([part.triangles for part in parts]).reshape(-1, 3)
    vertices, faces = np.unique(soup, axis=0, return_inverse=True)  # exact equality, no tolerance
    sphere = trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False)
    assert sphere.is_watertight
    assert sphere.is_winding_consistent
    assert sphere.volume == pytest.approx(4 / 3 * np.pi * SPHERE_RADIUS**3, rel=0.005)
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(np.full(len(vertices), SPHERE_RADIUS), abs=0.02)


@pytest.mark.parametrize("key", [ChunkKey(0, -1, 0, 0), ChunkKey(1, -1, -1, 0), ChunkKey(0, FAR, -1, -FAR)])
def test_all_formats_hold_the_same_mesh(key: ChunkKey):
    std = decode(chunk("hills", key, Encoding()).body)
    f32 = decode(chunk("hills", key, Encoding(profile="f32")).body)
    glb = trimesh.load_scene(io.BytesIO(chunk("hills", key).body), file_type="glb", process=False).to_mesh()
    assert metres(std) == metres(f32) == glb.vertices.tolist()
    assert std["indices"].tolist() == f32["indices"].tolist() == glb.faces.reshape(-1).tolist()
    assert np.abs(std["normals"][:, :3] / 127 - f32["normals"]).max() <= 0.5 / 127 + 1e-6
