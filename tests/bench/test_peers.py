"""Peers do the work that they are measured for: the same surface, the same points, the same answers."""

import pickle

import httpx2
import numpy as np
import pytest
from opensimplex import OpenSimplex  # type: ignore[import-untyped]
from scipy.spatial import KDTree

from benchmarks import peer_noise, whole
from benchmarks.bare import learn
from benchmarks.extraction import PEERS, corners
from benchmarks.scenes import SCENES, SEED, SHAPE, prepare
from benchmarks.service import chunk_request
from benchmarks.skipping import ALTITUDE_VOXELS, FLIGHTS, build_sampled, cut
from chunkserver.grid import POSITION_LOW, ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from tests.serving import serving

APART_MAX = 1.0 / SHAPE.units_per_cell + 1e-5
"""Cells, between the same vertex of two meshes: ours is rounded to the lattice and kept off corners."""
INNER_MAX = 0.05
"""Of the vertices of skimage's lewiner: those that it puts inside of cells whose topology wants one."""
TRIANGLES_APART_MAX = 0.05
KEY = ChunkKey(0, 3, -2, 7)
PLAIN = {"Accept-Encoding": "identity"}


@pytest.mark.parametrize("name", PEERS)
@pytest.mark.parametrize("scene", ["terrain underground", "planet"])
def test_extraction_finds_our_surface(scene, name):
    for chunk in prepare(SCENES[scene], 2):
        peer = PEERS[name]
        vertices, triangles = peer.surface(peer.extract(peer.ready(corners(chunk))))
        mine = ((chunk.mesh.positions[:, :3].astype(float) - POSITION_LOW) / SHAPE.units_per_cell)[:, [1, 2, 0]]
        assert KDTree(vertices).query(mine)[0].max() <= APART_MAX
        strays = KDTree(mine).query(vertices)[0] > APART_MAX
        assert strays.mean() <= (INNER_MAX if name == "skimage lewiner" else 0)
        assert len(triangles) == pytest.approx(len(chunk.mesh.triangles), rel=TRIANGLES_APART_MAX)


def test_those_that_take_an_empty_block_find_nothing():
    (chunk,) = prepare(SCENES["empty air"], 1)
    for peer in PEERS.values():
        if peer.empty:
            found = peer.extract(peer.ready(corners(chunk)))
            assert not (found.GetNumberOfCells() if hasattr(found, "GetNumberOfCells") else len(found[1]))


def test_opensimplex_gets_the_points_of_the_samples():
    noise, (x, y, z) = OpenSimplex(SEED), KEY.low_corner(SHAPE.cells)
    solid = peer_noise.open_simplex(3)(peer_noise.axes(KEY, 3, 0.05))
    assert solid.shape == (SHAPE.samples,) * 3
    assert solid[5, 6, 7] == noise.noise3((x - 1 + 7) * 0.05, (y - 1 + 6) * 0.05, (z - 1 + 5) * 0.05)
    flat = peer_noise.open_simplex(2)(peer_noise.axes(KEY, 2, 0.05))
    assert flat[5, 7] == noise.noise2((x - 1 + 7) * 0.05, (z - 1 + 5) * 0.05)


def test_fast_noise_gets_the_points_of_the_samples():
    for dimensions in (2, 3):
        points = peer_noise.points(KEY, dimensions)
        low = KEY.low_corner(SHAPE.cells)
        places = low if dimensions == 3 else (low[0], low[2])
        assert points.shape == (dimensions, SHAPE.samples**dimensions)
        assert points.min(axis=1).tolist() == [place - SHAPE.apron for place in places]
        assert len(np.unique(points, axis=1).T) == SHAPE.samples**dimensions
        values = peer_noise.fast_noise("OpenSimplex2", 0.05)(points)
        assert values.shape == (SHAPE.samples**dimensions,)
        assert values.min() < -0.5 < 0.5 < values.max()


def test_frequency_and_octaves_reach_fast_noise():
    points = peer_noise.points(KEY, 2)
    coarse = peer_noise.fast_noise("Perlin", 0.02)(points)
    assert np.allclose(coarse, peer_noise.fast_noise("Perlin", 0.04)(points / np.float32(2)), rtol=0, atol=1e-3)
    for other in (peer_noise.fast_noise("Perlin", 0.04), peer_noise.fast_noise("Perlin", 0.02, octaves=5)):
        assert not np.allclose(coarse, other(points), rtol=0, atol=0.1)


def test_whole_chunk_of_the_peer_is_like_ours():
    """As many triangles, as much open rock, but for the luck of other caves in so few chunks."""
    chunks = prepare(SCENES[whole.SCENE], 16)
    pieces = [whole.peer()(chunk.request.key) for chunk in chunks]
    counts = [piece.triangles for piece in pieces]
    assert sum(counts) == pytest.approx(sum(len(chunk.mesh.triangles) for chunk in chunks), rel=0.15)
    assert all(len(piece.body) > 12 * piece.triangles for piece in pieces)
    theirs = np.mean([whole.peer_field()(chunk.request.key) >= 0 for chunk in chunks])
    assert theirs == pytest.approx(np.mean([corners(chunk) >= 0 for chunk in chunks]), rel=0.1)


def test_without_proof_the_bytes_are_the_same():
    contents = set()
    for flight in FLIGHTS:
        recipe = WorldRecipe(SEED, builtin(flight.recipe))
        for key in list(cut(flight.place(0)))[::40]:
            request = ChunkRequest(recipe, key)
            chunk = build_chunk(request)
            contents.add(chunk.content)
            assert build_sampled(request) == chunk.body
    assert contents == {"air", "rock", "surface"}


def test_a_cut_is_balanced_and_has_no_gap():
    keys = list(cut((5.0, ALTITUDE_VOXELS, -40.0)))
    finest = {key for key in keys if key.lod == 0}
    assert ChunkKey(0, 0, 0, -2) in finest
    boxes = np.array([[*key.low_corner(SHAPE.cells), SHAPE.cells << key.lod] for key in keys])
    low, side = boxes[:, None, :3], boxes[:, None, 3:]
    high, other, wide = low + side, boxes[None, :, :3], boxes[None, :, 3:]
    touch = ((low <= other + wide) & (other <= high)).all(axis=2)
    ratios = np.maximum(side / wide, wide / side)[:, :, 0]
    assert ratios[touch].max() == 2
    assert ((low < other + wide) & (other < high)).all(axis=2).sum() == len(keys), "leaves overlap"
    assert (boxes[:, 3].astype(float) ** 3).sum() == (3 * (SHAPE.cells << 5)) ** 3


def test_fastapi_answers_as_we_do(tmp_path):
    (chunk,) = prepare(SCENES["terrain surface"], 1)
    path = chunk_request(chunk.request.key).path
    answers = tmp_path / "answers"
    with serving(tmp_path / "ours") as ours, httpx2.Client(base_url=ours.url) as client:
        answers.write_bytes(pickle.dumps(learn(client, [path])))
        tag = client.get(path, headers=PLAIN).headers["etag"]
        mine = asked(client, path, tag)
    program = "-m", "benchmarks.idiomatic"
    with (
        serving(tmp_path / "peer", str(answers), program=program) as peer,
        httpx2.Client(base_url=peer.url) as client,
    ):
        assert asked(client, path, tag) == mine
        assert client.get(path, params={"cells": 5}).status_code == 422
        assert client.get(f"{path}5").status_code == 404


def asked(client: httpx2.Client, path: str, tag: str) -> list[tuple[int, set[tuple[str, str]], bytes]]:
    """Return status, headers and body of an answer in full and of one to a client that has it already."""
    found = [client.get(path, headers=headers) for headers in (PLAIN, {**PLAIN, "If-None-Match": tag})]
    assert [answer.status_code for answer in found] == [200, 304]
    skip = {"date", "x-request-id"}
    return [
        (answer.status_code, {item for item in answer.headers.items() if item[0] not in skip}, answer.content)
        for answer in found
    ]
