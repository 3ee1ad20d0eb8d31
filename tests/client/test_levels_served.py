"""Selections of a real world, fetched as a stranger would and welded: no hole, whatever is drawn."""

from collections.abc import Iterable, Iterator
from typing import Any, Final

import httpx2
import numpy as np
import pytest

from chunkserver_client import BadAnswer, ChunkMesh, Client, FittedChunk, LevelOfDetail, WorldDescriptor, swaps
from chunkserver_client.descriptors import read_seed
from chunkserver_client.json_tree import Json
from tests.serving import Server
from tests.surfaces import edges_of, weld

BOX: Final = ((-128, -128, -128), (128, 128, 128))
PLANET: Final = {"builtin": "planet", "radius": 70, "relief": 16}
LODS: Final = 4
HERE: Final = (20.0, 74.0, 8.0)
THERE: Final = (60.0, 40.0, 40.0)


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client(server.url) as found:
        yield found


@pytest.fixture
def world(client: Client) -> Iterator[WorldDescriptor]:
    """A planet that lies in its box, so that nothing of it is open."""
    yield client.create_world("levels", seed=3, recipe=PLANET, lods=LODS, chunk_cells=16)
    client.delete_world("levels")


def fetched(client: Client, world: WorldDescriptor, chunks: Iterable[FittedChunk]) -> dict[FittedChunk, ChunkMesh]:
    wanted = {chunk.key: chunk for chunk in chunks}
    return {wanted[mesh.key]: mesh for mesh in client.chunks(world, wanted.values(), viewer=HERE)}


def open_edges(meshes: Iterable[ChunkMesh]) -> int:
    pairs: list[Any] = [(mesh.key, mesh) for mesh in meshes]
    return int(np.count_nonzero(edges_of(weld(pairs)).balance))


def test_what_is_selected_is_closed_also_half_way_to_the_next_selection(client, world):
    levels = LevelOfDetail(world, error_pixels=30, box=BOX, reach=512)
    before = levels.select(HERE)
    after = levels.select(THERE, previous=before)
    meshes = fetched(client, world, after.chunks)
    meshes |= fetched(client, world, before.chunks)
    drawn = before.chunks
    assert {chunk.lod for chunk in drawn if not meshes[chunk].is_empty} >= {0, 1, 2}
    assert sum(len(meshes[chunk].triangles) for chunk in drawn) > 1000
    assert open_edges(meshes[chunk] for chunk in drawn) == 0
    steps = swaps(drawn, after.chunks)
    for step in steps:
        drawn = (drawn - step.old) | step.new
        assert open_edges(meshes[chunk] for chunk in drawn) == 0
    assert drawn == after.chunks != before.chunks


def test_without_its_masks_it_gapes(client, world):
    chunks = LevelOfDetail(world, error_pixels=30, box=BOX, reach=512).select(HERE).chunks
    plain = fetched(client, world, (chunk._replace(coarser=0) for chunk in chunks))
    assert open_edges(plain.values()) > 0


def test_the_descriptor_may_say_how_far_a_level_is_off(server):
    stated = httpx2.get(f"{server.url}/v1/seeds/1").raise_for_status().json()
    errors = [0.125 * lod for lod in range(stated["lods"])]
    assert read_seed(Json(stated | {"geometric_errors": errors})).geometric_errors == tuple(errors)
    assert read_seed(Json(stated | {"geometric_errors": None})).geometric_errors is None
    for bad in (errors[1:], [-1.0, *errors[1:]], ["0", *errors[1:]], 7):
        with pytest.raises(BadAnswer, match="geometric_errors"):
            read_seed(Json(stated | {"geometric_errors": bad}))
