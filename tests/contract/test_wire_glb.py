"""GLBs in the hands of others: the Khronos validator, and trimesh."""

import io
import json
import subprocess
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import trimesh

from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.wire import Encoding, Placement, encode
from tests.unit.wire.meshes import strip

TESTS: Final = Path(__file__).parents[1]
VALIDATOR_SECONDS: Final = 60
FRAMES: Final = ("world", "chunk")
PLACEMENTS: Final = (
    Placement(ChunkKey(0, 0, 0, 0), 32, 1.0),
    Placement(ChunkKey(2, -3, 0, 5), 32, 0.5, 2**63 - 1, 63),
    Placement(ChunkKey(0, -(2**35), 2**35 - 1, 0), 32, 0.1),
    Placement(ChunkKey(20, -1, 1, -(2**14)), 64, 2.0**20),
    Placement(ChunkKey(0, 7, -7, 0), 16, 2.0**-20),
)


def issues(folder: Path, files: list[bytes]) -> list[dict[str, Any]]:
    """Return the validator's findings on each GLB."""
    paths = [folder / f"{number}.glb" for number in range(len(files))]
    for path, file in zip(paths, files, strict=True):
        path.write_bytes(file)
    run = subprocess.run(
        ["node", "gltf_validate.mjs", *map(str, paths)],
        cwd=TESTS,
        check=True,
        capture_output=True,
        timeout=VALIDATOR_SECONDS,
    )
    return [report["issues"] for report in json.loads(run.stdout)]


def test_validator_has_nothing_to_say(tmp_path: Path):
    meshes = [EMPTY["air"], EMPTY["rock"], *(strip(vertices) for vertices in (3, 4, 5, 6, 1000, 65535, 65536))]
    files = [
        encode(mesh, placement, Encoding("glb", frame=frame))
        for mesh, placement, frame in product(meshes, PLACEMENTS, FRAMES)
        if len(mesh.positions) <= 1000 or placement == PLACEMENTS[1]
    ]
    for found in issues(tmp_path, files):
        assert (found["numErrors"], found["numWarnings"], found["numHints"]) == (0, 0, 0), found["messages"]


def test_validator_sees_what_is_wrong(tmp_path: Path):
    good = encode(strip(5), PLACEMENTS[1], Encoding("glb"))
    bad = [
        good.replace(b'"max":[', b'"min":[', 1),
        good.replace(b'"extensionsUsed":["KHR_mesh_quantization"],', b" " * 43, 1),
        good[:-4] + b"\xff\xff\xff\xff",
    ]
    assert all(file != good for file in bad)
    assert all(found["numErrors"] for found in issues(tmp_path, bad))


def normals_as_bytes() -> np.ndarray:
    """Return all byte triples of one octant that a unit vector can be rounded to: (N, 3)."""
    axis = np.arange(128.0)
    triples = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    nearest = (np.maximum(triples - 0.5, 0) ** 2).sum(axis=1)
    farthest = ((triples + 0.5) ** 2).sum(axis=1)
    reached: np.ndarray = triples[(nearest <= 127**2) & (farthest >= 127**2)]
    return reached


def with_normals(triples: np.ndarray) -> Mesh:
    mesh = strip(len(triples))
    normals = np.zeros((len(triples), 4), np.int8)
    normals[:, :3] = triples
    return replace(mesh, normals=normals)


def test_every_rounded_normal_is_a_unit_vector_but_those_that_the_page_names(tmp_path: Path):
    exceptions = set(permutations((67.0, 76.0, 78.0)))
    triples = normals_as_bytes()
    named = np.array([tuple(triple) in exceptions for triple in triples.tolist()])
    assert named.sum() == len(exceptions)
    files = [encode(with_normals(triples[chosen]), PLACEMENTS[0], Encoding("glb")) for chosen in (~named, named)]
    fine, not_unit = issues(tmp_path, files)
    assert fine["numErrors"] == 0
    assert not_unit["numErrors"] == len(exceptions)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("placement", PLACEMENTS)
def test_trimesh_finds_the_vertices_where_they_are(placement: Placement, frame: str):
    mesh = strip(100)
    file = io.BytesIO(encode(mesh, placement, Encoding("glb", frame=frame)))
    loaded = trimesh.load_scene(file, file_type="glb", process=False).to_mesh()
    side = placement.voxel_size * placement.cells * 2**placement.key.lod
    corner = np.array(placement.key[1:] if frame == "world" else (0, 0, 0))
    expected = side * (corner + (mesh.positions[:, :3] - 16384.0) / 32768)
    error = 0.0 if np.log2(placement.voxel_size).is_integer() else 1e-15 * np.abs(expected).max()
    assert np.abs(loaded.vertices - expected).max() <= error
    assert np.array_equal(loaded.faces, mesh.triangles)


def test_trimesh_reads_an_empty_chunk():
    file = io.BytesIO(encode(EMPTY["rock"], PLACEMENTS[1], Encoding("glb")))
    assert not trimesh.load_scene(file, file_type="glb").geometry
