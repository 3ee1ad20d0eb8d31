import asyncio
import dataclasses
import threading

import pytest

from chunkserver.edits import Edit
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.chunks import IMMUTABLE, NO_STORE, REVALIDATE
from chunkserver.server.parameters import WorldChunkQuery
from chunkserver.server.plan import VARY
from chunkserver.server.problems import UnknownRevision
from chunkserver.server.world_chunks import revision_headers
from chunkserver.wire import Encoding
from chunkserver.world import World
from tests.unit.server.stub import StubPool, client_of

URL = "/v1/worlds/w/chunks/3/1/-2/5"
NEW = {"id": "w", "seed": 42, "recipe": "hills", "voxel_size": 0.5, "lods": 5, "chunk_cells": 16}
WORLD = World(id="w", recipe=WorldRecipe(42, builtin("hills")), recipe_name="hills", generator="ab", epoch="cd")
WAIT_SECONDS_MAX = 20.0
IN_THE_SKY = {"op": "carve", "shape": "sphere", "center": [0, 9000, 0], "radius": 3}


@pytest.fixture
def pool():
    return StubPool()


@pytest.fixture
def client(pool):
    with client_of(pool) as client:
        client.post("/v1/worlds", json=NEW).raise_for_status()
        yield client


@pytest.fixture
def tokens(client):
    found = client.get("/v1/worlds/w").json()
    return f"g={found['generator']}&epoch={found['epoch']}"


def at(client, revision):
    """Have the world take edits, none of which changes anything."""
    while int(client.get("/v1/worlds/w").json()["revision"]) < revision:
        client.post("/v1/worlds/w/edits", json={"strokes": [IN_THE_SKY]}).raise_for_status()


def test_the_url_and_the_world_say_what_is_built(client, pool):
    client.get(f"{URL}.glb?frame=chunk&seam=none&mesher=marching-cubes&coarser=0")
    client.get(f"{URL}?profile=f32")
    client.get(f"{URL}.mesh?profile=f32")
    client.get(f"{URL}?frame=chunk", headers={"Accept": "model/gltf-binary"})
    wanted = ChunkRequest(WORLD.recipe, ChunkKey(3, 1, -2, 5), cells=16, voxel_size=0.5)
    assert pool.built == [
        dataclasses.replace(wanted, seam="none", encoding=Encoding("glb", frame="chunk")),
        dataclasses.replace(wanted, encoding=Encoding("mesh", "f32")),
        dataclasses.replace(wanted, encoding=Encoding("glb", frame="chunk")),
    ]


@pytest.mark.parametrize("query", ["", "?g={g}", "?epoch={e}", "?g={g}&epoch={e}", "?revision=0", "?revision=0&g={g}"])
def test_an_answer_that_is_asked_for_again(client, tokens, query):
    g, epoch = (pair.partition("=")[2] for pair in tokens.split("&"))
    answer = client.get(URL + query.format(g=g, e=epoch))
    assert (answer.status_code, answer.headers["cache-control"], answer.headers["vary"]) == (200, REVALIDATE, VARY)
    assert (answer.headers["chunk-revision"], answer.headers["world-revision"]) == ("0", "0")


def test_an_answer_that_may_be_kept_for_ever(client, tokens):
    fresh = client.get(f"{URL}?revision=0&{tokens}")
    known = client.get(f"{URL}?revision=0&{tokens}", headers={"If-None-Match": fresh.headers["etag"]})
    assert (fresh.status_code, known.status_code) == (200, 304)
    for answer in (fresh, known):
        assert (answer.headers["cache-control"], answer.headers["chunk-revision"]) == (IMMUTABLE, "0")
        assert "world-revision" not in answer.headers
    assert fresh.headers["etag"] == client.get(URL).headers["etag"]


def test_a_304_builds_nothing_and_tells_the_revisions(client, pool):
    answer = client.get(URL, headers={"If-None-Match": "*"})
    assert (answer.status_code, answer.headers["cache-control"]) == (304, REVALIDATE)
    assert (answer.headers["chunk-revision"], answer.headers["world-revision"]) == ("0", "0")
    assert not pool.built


@pytest.mark.parametrize(
    ("revision", "chunk_revision", "named", "cache_control"),
    [
        (5, 3, None, REVALIDATE),
        (5, 3, "5", IMMUTABLE),
        (5, 3, "4", IMMUTABLE),
        (5, 3, "3", IMMUTABLE),
        (5, 3, "2", NO_STORE),
        (5, 3, "0", NO_STORE),
        (0, 0, "0", IMMUTABLE),
    ],
)
def test_how_long_an_answer_may_be_kept(revision, chunk_revision, named, cache_control):
    world = dataclasses.replace(WORLD, revision=revision)
    headers = revision_headers(world, chunk_revision, WorldChunkQuery(revision=named, g="ab", epoch="cd"))
    assert headers["Cache-Control"] == cache_control
    assert headers["Chunk-Revision"] == str(chunk_revision)
    assert headers.get("World-Revision") == (None if cache_control == IMMUTABLE else str(revision))


@pytest.mark.parametrize("tokens", [{}, {"g": "ab"}, {"epoch": "cd"}])
def test_without_both_tokens_no_url_stands_for_these_bytes(tokens):
    world = dataclasses.replace(WORLD, revision=5)
    for named in ("5", "2", None):
        headers = revision_headers(world, 3, WorldChunkQuery(revision=named, **tokens))
        assert headers == {"Chunk-Revision": "3", "World-Revision": "5", "Cache-Control": REVALIDATE}


def test_a_revision_that_is_yet_to_come(client, pool, tokens):
    with pytest.raises(UnknownRevision):
        revision_headers(dataclasses.replace(WORLD, revision=5), 3, WorldChunkQuery(revision="6"))
    for url in (f"{URL}?revision=1", f"{URL}?revision=1&{tokens}"):
        answer = client.get(url, headers={"If-None-Match": "*"})
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:chunkserver:problem:unknown-revision")
        assert (answer.json()["revision"], answer.json()["world_revision"]) == ("1", "0")
    at(client, 1)
    assert client.get(f"{URL}?revision=1").status_code == 200
    assert len(pool.built) == 1


@pytest.mark.parametrize(
    ("query", "name"),
    [("g=0123", "old-generator"), ("epoch=0123", "old-epoch"), ("revision=0&epoch=0123", "old-epoch")],
)
@pytest.mark.parametrize("headers", [{}, {"If-None-Match": "*"}])
def test_another_token_is_gone_and_the_current_one_named(client, pool, query, name, headers):
    answer = client.get(f"{URL}?{query}", headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (410, f"urn:chunkserver:problem:{name}")
    found = client.get("/v1/worlds/w").json()
    assert found["generator"] in answer.text or found["epoch"] in answer.text
    assert not pool.built


def test_tags_of_worlds_are_their_own(client, pool):
    tags = [client.get(URL).headers["etag"]]
    client.delete("/v1/worlds/w")
    client.post("/v1/worlds", json=NEW)
    tags.append(client.get(URL).headers["etag"])
    client.post("/v1/worlds", json=NEW | {"id": "x"})
    tags.append(client.get(URL.replace("/w/", "/x/")).headers["etag"])
    client.post("/v1/worlds", json={"id": "y", "seed": 42, "recipe": "hills"})
    tags += [
        client.get(url).headers["etag"]
        for url in (URL.replace("/w/", "/y/"), "/v1/seeds/42/chunks/3/1/-2/5?recipe=hills")
    ]
    assert len(set(tags)) == len(tags) == len(pool.built)


@pytest.mark.parametrize("is_known_kind", [False, True])
@pytest.mark.parametrize(
    ("by_now", "status", "name"),
    [({}, 404, "unknown-world"), ({"w": dataclasses.replace(WORLD, epoch="ef")}, 410, "old-epoch")],
)
def test_a_world_that_goes_while_its_chunk_is_built(client, pool, monkeypatch, is_known_kind, by_now, status, name):
    """By the application, and by the front, which knows how to answer chunks beside one that was asked for."""
    if is_known_kind:
        client.get(URL)
    build, catalogue = pool.build, client.app.state.service.worlds._catalogue
    now = {key: dataclasses.replace(world, generator=catalogue.find("w").generator) for key, world in by_now.items()}

    async def build_late(*request, **rank):
        catalogue._worlds = now
        return await build(*request, **rank)

    monkeypatch.setattr(pool, "build", build_late)
    answer = client.get("/v1/worlds/w/chunks/3/1/-2/6")
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:chunkserver:problem:{name}")
    assert "etag" not in answer.headers


def test_an_edit_elsewhere_leaves_the_tag_alone(client):
    before = client.get(URL).headers
    at(client, 7)
    after = client.get(URL).headers
    assert (after["etag"], after["chunk-revision"], after["world-revision"]) == (before["etag"], "0", "7")


def test_min_revision_is_waited_for(client):
    """The test's thread edits while another one waits for the answer."""
    store = client.app.state.service.worlds
    found = []
    waiting = threading.Thread(target=lambda: found.append(client.get(f"{URL}?min_revision=2&revision=2")))
    waiting.start()

    async def edit():
        while not store._moved._waiters:
            await asyncio.sleep(0.001)
        for revision in (1, 2):
            await store.edits.take(store.find("w"), Edit.of([IN_THE_SKY]), None)
            await asyncio.sleep(0.01)
            if revision == 1:
                assert not found, "one that is too old wakes nobody for good"

    client.portal.call(edit)
    waiting.join(WAIT_SECONDS_MAX)
    assert (found[0].status_code, found[0].headers["world-revision"]) == (200, "2")
    assert client.get(f"{URL}?min_revision=2").status_code == 200


def test_min_revision_does_not_come_in_time(client, pool):
    client.app.state.service.worlds.answer_seconds = 0.05
    answer = client.get(f"{URL}?min_revision=3", headers={"If-None-Match": "*"})
    assert (answer.status_code, answer.json()["type"]) == (503, "urn:chunkserver:problem:deadline-passed")
    assert answer.json()["min_revision"] == "3"
    assert int(answer.headers["retry-after"]) > 0
    assert not pool.built


def test_a_world_that_is_deleted_ends_the_waiting(client):
    store, found = client.app.state.service.worlds, []
    waiting = threading.Thread(target=lambda: found.append(client.get(f"{URL}?min_revision=2")))
    waiting.start()

    async def delete():
        while not store._moved._waiters:
            await asyncio.sleep(0.001)
        await store.delete("w")

    client.portal.call(delete)
    waiting.join(WAIT_SECONDS_MAX)
    assert found[0].json()["type"] == "urn:chunkserver:problem:unknown-world"


@pytest.mark.parametrize("query", ["min_revision=1&g=00", "min_revision=1&coarser=64", "min_revision=1&epoch=00"])
def test_nobody_waits_for_a_refusal(client, query):
    assert client.get(f"{URL}?{query}").status_code in (410, 422)


@pytest.mark.parametrize("content", ["air", "rock"])
def test_an_empty_chunk(client, pool, content):
    pool.chunk = Chunk(content, b"not sent as .mesh")
    native, glb = client.get(f"{URL}.mesh"), client.get(f"{URL}.glb")
    assert (native.status_code, native.content, glb.status_code, glb.content) == (204, b"", 200, pool.chunk.body)
    for answer in (native, glb):
        assert (answer.headers["chunk-content"], answer.headers["chunk-revision"]) == (content, "0")


@pytest.mark.parametrize(
    ("url", "name", "value"),
    [
        ("/v1/worlds/W/chunks/0/0/0/0", "world", "W"),
        ("/v1/worlds/w/chunks/5/0/0/0", "lod", 5),
        ("/v1/worlds/w/chunks/0/68719476736/0/0", "x", 1 << 36),
        (f"{URL}?recipe=hills", "recipe", "hills"),
        (f"{URL}?revision=-1", "revision", "-1"),
        (f"{URL}?revision=9223372036854775808", "revision", "9223372036854775808"),
        (f"{URL}?min_revision=x", "min_revision", "x"),
        (f"{URL}?epoch=NOHEX", "epoch", "NOHEX"),
        (f"{URL}.glb?profile=std", "profile", "std"),
        (f"{URL}.mesh?frame=chunk", "frame", "chunk"),
        (f"{URL}?seam=walls", "seam", "walls"),
        (f"{URL}?coarser=1&seam=skirts", "coarser", 1),
        ("/v1/worlds/w/chunks/4/0/0/0?coarser=32", "coarser", 32),
        (f"{URL}?g=00&g=00", "g", "00"),
    ],
)
def test_what_cannot_be_answered_is_refused_by_name(client, pool, url, name, value):
    answer = client.get(url, headers={"If-None-Match": "*"})
    assert (answer.status_code, answer.json()[name]) == (422, value)
    assert "None" not in answer.json()["detail"]
    assert not pool.built


def test_the_last_chunk_of_small_cells(client):
    assert client.get("/v1/worlds/w/chunks/0/68719476735/0/0").status_code == 200
    assert client.get("/v1/worlds/w/chunks/4/0/0/0").status_code == 200


def test_no_world(client):
    answer = client.get("/v1/worlds/nobody/chunks/0/0/0/0", headers={"If-None-Match": "*"})
    assert (answer.status_code, answer.json()["world"]) == (404, "nobody")


def test_its_urls_work_and_their_promises_are_kept(client):
    found = client.get("/v1/worlds/w").json()
    for name, cache_control in (("chunk", REVALIDATE), ("chunk_immutable", IMMUTABLE)):
        for row in found["formats"]:
            place = {"lod": found["lods"] - 1, "x": 0, "y": -1, "z": 0, "extension": row["extension"]}
            answer = client.get(found["urls"][name].format(**place, revision=found["revision"]))
            assert (answer.status_code, answer.headers["content-type"]) == (200, row["media_type"])
            assert answer.headers["cache-control"] == cache_control
