"""Every call of either client against a real server, which is asked by plain HTTP what it should be."""

import re
import secrets
import subprocess
import sys
from typing import Any, NamedTuple

import httpx2
import numpy as np
import pytest

from chunkserver_client import (
    BadRequest,
    ChunkKey,
    Conflict,
    Gone,
    NotAllowed,
    NotFound,
    Problem,
    Retry,
    Unavailable,
    Unreachable,
    decode,
    driving,
)
from tests.client.chaos import chaos
from tests.serving import serving

KEY = (0, 0, -1, 0)
BOWL = {"op": "max", "a": {"op": "y"}, "b": {"op": "subtract", "a": 0, "b": {"op": "sphere", "radius": 20}}}


def plain(server, path: str) -> Any:
    return httpx2.get(server.url + path).raise_for_status().json()


def same(mesh, wanted) -> bool:
    return all(
        np.array_equal(getattr(mesh, name), getattr(wanted, name)) for name in ("positions", "normals", "triangles")
    )


@pytest.fixture
def world(client):
    """A world of its own for a test."""
    name = f"w{secrets.token_hex(8)}"
    yield client.create_world(name, -(2**63), "planet", voxel_size=0.5, lods=3, chunk_cells=16)
    client.delete_world(name)


def test_the_descriptor_of_a_seed(client, server):
    found, wanted = client.seed(-7, "planet"), plain(server, "/v1/seeds/-7?recipe=planet")
    assert (found.kind, found.seed, found.path) == ("seed", -7, "/v1/seeds/-7")
    assert (found.recipe.name, found.recipe.digest) == ("planet", wanted["recipe"]["digest"])
    assert found.recipe.expression == wanted["recipe"]["expression"]
    for name in ("generator", "voxel_size", "chunk_cells", "lods"):
        assert getattr(found, name) == wanted[name]
    for name in ("meshers", "seams", "coarser"):
        assert list(getattr(found, name)) == wanted[name]
    assert [list(found.low), list(found.high)] == [wanted["bounds"]["min"], wanted["bounds"]["max"]]
    for format_of, row in zip(found.formats, wanted["formats"], strict=True):
        assert {name: list(v) if isinstance(v := getattr(format_of, name), tuple) else v for name in row} == row


def test_the_descriptor_of_a_world(client, server, world):
    wanted = plain(server, world.path)
    assert client.world(world.id) == world
    assert (world.kind, world.seed, world.voxel_size, world.lods, world.chunk_cells) == ("world", -(2**63), 0.5, 3, 16)
    assert (world.id, world.epoch, str(world.revision)) == (wanted["id"], wanted["epoch"], wanted["revision"])
    assert world.created.strftime("%Y-%m-%dT%H:%M:%SZ") == wanted["created"]
    assert (world.durable, world.answer_seconds) == (wanted["durable"], wanted["limits"]["answer_seconds"])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"format": "glb"},
        {"format": "glb", "frame": "chunk"},
        {"profile": "f32"},
        {"mesher": "marching-cubes", "seam": "none", "coarser": 0, "urgency": 0},
    ],
)
def test_a_chunk_of_a_seed(client, server, options):
    mesh = client.chunk(client.seed(42), KEY, **options)
    query = {name: value for name, value in options.items() if name not in {"format", "urgency"}}
    answer = httpx2.get(f"{server.url}/v1/seeds/42/chunks/0/0/-1/0.{options.get('format', 'mesh')}", params=query)
    assert same(mesh, decode(answer.content, answer.headers["content-type"]))
    assert (mesh.key, mesh.cells, mesh.voxel_size, mesh.content) == (ChunkKey(*KEY), 32, 1.0, "surface")


@pytest.mark.parametrize("format_", ["mesh", "glb"])
def test_a_batch_with_a_mask_for_each_chunk(client, server, format_):
    world, low = client.seed(42), (0, 0, -1, 0)
    rows = [low, (*low, 1), (*low, 63), (1, 0, 0, 0, 4)]
    found = {(*mesh.key, mesh.coarser): mesh for mesh in client.chunks(world, rows, format=format_)}
    assert set(found) == {(*low, 0), *rows[1:]}
    for (*key, mask), mesh in found.items():
        query = {"coarser": mask}
        answer = httpx2.get(f"{server.url}/v1/seeds/42/chunks/{'/'.join(map(str, key))}.{format_}", params=query)
        assert same(mesh, decode(answer.content, answer.headers["content-type"]))
    assert not same(found[(*low, 0)], found[(*low, 63)])
    with pytest.raises(BadRequest, match="coarser is 7"):
        list(client.chunks(world, [low, (20, 0, 0, 0, 7)]))


@pytest.mark.parametrize("options", [{}, {"revision": 0}, {"min_revision": 0, "format": "glb"}])
def test_a_chunk_of_a_world(client, server, world, options):
    mesh = client.chunk(world, (1, 4, 3, 0), **options)
    answer = httpx2.get(f"{server.url}{world.path}/chunks/1/4/3/0")
    wanted = decode(answer.content)
    assert same(mesh, wanted)
    assert (mesh.cells, mesh.voxel_size, mesh.revision, len(mesh.positions) > 0) == (16, 0.5, 0, True)


@pytest.mark.parametrize("format_", ["mesh", "glb"])
@pytest.mark.parametrize(("y", "content"), [(9, "air"), (-9, "rock")])
def test_an_empty_chunk(client, format_, y, content):
    mesh = client.chunk(client.seed(1, "plane"), (0, 0, y, 0), format=format_)
    assert (mesh.content, mesh.is_empty, mesh.key.y, mesh.cells) == (content, True, y, 32)
    assert mesh.positions.shape == mesh.triangles.shape == (0, 3)


def test_the_head_of_a_chunk(connect, server):
    client = connect(server.url, coding="identity")
    head = client.chunk_head(client.seed(42), KEY)
    answer = httpx2.get(f"{server.url}/v1/seeds/42/chunks/0/0/-1/0", headers={"accept-encoding": "identity"})
    assert (head.etag, head.content) == (answer.headers["etag"].strip('"'), "surface")
    assert (head.content_bytes, head.revision) == (len(answer.content), 0)
    assert client.chunk_head(client.seed(42), (0, 0, 9, 0)).content_bytes == 0


@pytest.mark.parametrize("coding", ["gzip", "zstd"])
def test_the_head_of_a_coded_chunk(connect, server, coding):
    """It names the coding of a body that is not there."""
    client = connect(server.url, coding=coding)
    head = client.chunk_head(client.seed(42), KEY)
    answer = httpx2.head(f"{server.url}/v1/seeds/42/chunks/0/0/-1/0", headers={"accept-encoding": coding})
    assert answer.headers["content-encoding"] == coding
    assert head.content_bytes == int(answer.headers["content-length"]) > 0


@pytest.mark.parametrize("coding", ["identity", "gzip", "zstd"])
@pytest.mark.parametrize("format_", ["mesh", "glb"])
def test_a_batch(connect, server, coding, format_):
    client = connect(server.url, coding=coding)
    world = client.seed(42)
    keys = [(lod, x, y, 0) for lod in (0, 1) for x in range(-1, 2) for y in (-1, 0, 9)]
    meshes = list(client.chunks(world, [*keys, *keys], viewer=(0, 0, 0), format=format_))
    assert sorted(mesh.key for mesh in meshes) == sorted(keys)
    alone = connect(server.url, cache_bytes=0)
    for mesh in meshes:
        wanted = alone.chunk(world, mesh.key)
        assert same(mesh, wanted)
        assert mesh.content == wanted.content


def test_a_batch_fills_the_cache_for_single_chunks_and_the_other_way_round(connect, server):
    keys = [(0, x, y, 3) for x in range(3) for y in (-1, 9)]
    with chaos(server.url) as proxy:
        client = connect(proxy.url)
        world = client.seed(42)
        client.chunk(world, keys[0])
        assert len(list(client.chunks(world, keys))) == len(keys)
        assert '"chunks":[[0,0,9,3]' in proxy.bodies[-1]
        count = len(proxy.requests)
        for key in keys:
            client.chunk(world, key)
        assert len(list(client.chunks(world, keys))) == len(keys)
        assert len(proxy.requests) == count


def test_chunks_of_a_world_are_asked_for_again_by_tag(connect, server, world):
    keys = [(0, x, y, 0) for x in (7, 8) for y in (6, 7)]
    with chaos(server.url) as proxy:
        client = connect(proxy.url)
        first = {mesh.key: mesh for mesh in client.chunks(world, keys)}
        again = {mesh.key: mesh for mesh in client.chunks(world, keys)}
        assert proxy.bodies[-1].count('"') > proxy.bodies[0].count('"'), "the tags are named"
        assert all(same(first[key], again[key]) and first[key].content == again[key].content for key in first)
        one = client.chunk(world, keys[0])
        assert "if-none-match" in proxy.requests[-1]
        assert same(one, first[keys[0]])
        pinned = [client.chunk(world, keys[0], revision=world.revision) for _ in range(2)]
        assert len(proxy.requests) == 4, "a chunk of a known revision is asked for once"
        assert all(same(mesh, one) for mesh in pinned)


def test_more_keys_than_one_request_may_have(client):
    keys = [(0, x, 100, z) for x in range(33) for z in range(33)]
    assert len({mesh.key for mesh in client.chunks(client.seed(1, "plane"), keys)}) == 33 * 33


def test_a_batch_leaves_its_connection_for_the_next_request(connect, server, monkeypatch):
    opened: list[Any] = []
    head = driving.head

    def kept(response):
        opened.append(response)
        return head(response)

    monkeypatch.setattr(driving, "head", kept)
    client = connect(server.url)
    world = client.seed(42)
    assert len(list(client.chunks(world, [KEY, (0, 0, 9, 0)]))) == 2
    client.is_ready()
    assert len({id(answer.extensions["network_stream"]) for answer in opened}) == 1, "one connection for all"


def test_a_batch_may_be_left(client):
    world = client.seed(42)
    chunks = client.chunks(world, [(0, x, -1, z) for x in range(8) for z in range(8)])
    assert not next(chunks).is_empty
    chunks.close()
    assert client.chunk(world, KEY).key == KEY


def test_numbers_of_numpy_are_keys(client):
    keys = np.array([KEY, (0, 1, -1, 0)])
    assert len(list(client.chunks(client.seed(42), keys))) == 2
    with pytest.raises(TypeError):
        client.chunk(client.seed(42), (0, 0.0, 0, 0))


def test_recipes(client, server):
    listed = plain(server, "/v1/recipes")["recipes"]
    found = client.recipes()
    assert [(r.name, r.digest, r.description, r.parameters) for r in found] == [
        (row["name"], row["digest"], row["description"], row["parameters"]) for row in listed
    ]
    one = client.recipe("moon")
    assert one.expression == plain(server, "/v1/recipes/moon")["expression"]
    posted = client.post_recipe(BOWL)
    assert client.recipe(posted.digest) == posted
    assert client.recipe(posted.digest) == posted, "out of the cache"
    assert not client.chunk(client.seed(1, posted.digest), KEY).is_empty
    with pytest.raises(NotFound) as raised:
        client.recipe("0" * 32)
    assert raised.value.name == "unknown-recipe"


def test_worlds(client, world):
    found = {listed.id: listed for listed in client.worlds()}[world.id]
    for name in ("id", "epoch", "revision", "created", "seed", "generator"):
        assert getattr(found, name) == getattr(world, name)
    assert found.recipe == "planet"
    same_again = client.create_world(world.id, world.seed, "planet", voxel_size=0.5, lods=3, chunk_cells=16)
    assert same_again == world
    with pytest.raises(Conflict) as raised:
        client.create_world(world.id, 1)
    assert (raised.value.name, raised.value.values["id"]) == ("world-exists", world.id)


def test_worlds_of_many_pages(connect, server, monkeypatch):
    monkeypatch.setattr("chunkserver_client.calls.WORLDS_PER_PAGE", 2)
    client = connect(server.url)
    names = [f"page-{number}" for number in range(5)]
    for name in names:
        client.create_world(name, 1, BOWL)
    assert [found.id for found in client.worlds() if found.id in names] == names
    for name in names:
        client.delete_world(name)


def test_deleted_worlds_are_gone(client):
    client.create_world("short-lived", 1, "plane")
    client.delete_world("short-lived")
    for call in (client.world, client.delete_world):
        with pytest.raises(NotFound) as raised:
            call("short-lived")
        assert (raised.value.name, raised.value.values) == ("unknown-world", {"world": "short-lived"})


def test_an_id_is_one_part_of_the_path(client):
    for name in ("../seeds/42", "a?b", "a/chunks", "ä", "%"):
        with pytest.raises(Problem):
            client.world(name)


def test_what_the_server_refuses(client):
    world = client.seed(42)
    with pytest.raises(BadRequest) as raised:
        client.chunk(world, (21, 0, 0, 0))
    assert (raised.value.name, raised.value.values["lod"]) == ("bad-key", 21)
    with pytest.raises(BadRequest) as raised:
        list(client.chunks(world, [KEY, (21, 0, 0, 0)]))
    assert raised.value.values["index"] == 1
    with pytest.raises(BadRequest) as raised:
        client.chunk(world, KEY, format="glb", profile="f32")
    assert "profile" in raised.value.values
    with pytest.raises(BadRequest) as raised:
        client.post_recipe({"op": "max", "a": {"op": "y"}, "b": {"op": "sphere", "radius": -1}})
    assert raised.value.values["path"] == "b.radius"
    with pytest.raises(ValueError, match="JSON"):
        client.post_recipe(float("nan"))


def test_a_descriptor_of_another_generator_is_out_of_date(client, world):
    old = object.__new__(type(world))
    for name in world.__dataclass_fields__:
        object.__setattr__(old, name, getattr(world, name) if name != "epoch" else "0" * 32)
    with pytest.raises(Gone) as raised:
        client.chunk(old, KEY, revision=0)
    assert raised.value.name == "old-epoch"
    with pytest.raises(NotFound):
        client.chunk(world, KEY, revision=1)


def test_readiness(client, connect):
    assert client.is_ready()
    client.wait_until_ready(5)
    away = connect("http://127.0.0.1:9")
    assert not away.is_ready()
    with pytest.raises(Unreachable):
        away.wait_until_ready(0.2)


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://127.0.0.1", ""])
def test_a_url_that_is_none_is_refused(connect, url):
    with pytest.raises(ValueError, match="url"):
        connect(url)


@pytest.mark.parametrize("options", [{"coding": "br"}, {"timeout": httpx2.Timeout(None)}])
def test_settings_that_make_no_client_are_refused(connect, server, options):
    with pytest.raises(ValueError, match=r"coding|ever"):
        connect(server.url, **options)


@pytest.mark.parametrize("key", ["", "key\n", " key", "k\u00e9y"])
def test_a_key_that_no_header_can_have_is_refused_and_not_shown(connect, server, key):
    with pytest.raises(ValueError, match="api_key") as raised:
        connect(server.url, api_key=key)
    assert "key\n" not in str(raised.value)


class Guarded(NamedTuple):
    """A server that asks for keys, and is in a hurry."""

    url: str
    key: str


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    command = [sys.executable, "-m", "chunkserver", "key", "new", "--name", "writer", "--scope", "admin"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    (key,) = re.findall(r"^ +(chunkserver_\S+)$", said, re.MULTILINE)
    (entry,) = re.findall(r"CHUNKSERVER_API_KEYS=(\S+)", said)
    options = ("--workers", "1", "--api-keys", entry, "--answer-seconds", "2", "--build-seconds", "1")
    with serving(tmp_path_factory.mktemp("guarded") / "log", *options) as running:
        yield Guarded(running.url, key)


def test_api_keys(connect, guarded):
    writer = connect(guarded.url, api_key=guarded.key)
    assert writer.chunk(writer.seed(42), KEY).key == KEY
    assert len(list(writer.chunks(writer.seed(42), [KEY]))) == 1
    for api_key, name in ((None, "key-needed"), (guarded.key[:-1], "unknown-key")):
        with pytest.raises(NotAllowed) as raised:
            connect(guarded.url, api_key=api_key).seed(42)
        assert raised.value.name == name


def test_a_world_waits_for_a_revision_that_does_not_come(connect, guarded):
    client = connect(guarded.url, api_key=guarded.key, retry=Retry(attempts_max=1))
    world = client.create_world("w", 1, "plane")
    with pytest.raises(Unavailable) as raised:
        client.chunk(world, KEY, min_revision=1)
    assert raised.value.name == "deadline-passed"
    assert raised.value.retry_after > 0
