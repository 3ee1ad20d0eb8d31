"""What clients rely on, asked of the real server over a socket: the whole way, workers included."""

import json
import struct
from concurrent.futures import ThreadPoolExecutor

import httpx2
import pytest

from chunkserver.geometric_error import geometric_error
from chunkserver.grid import LOD_MAX, ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.serving import until

SURFACE = "/v1/seeds/42/chunks/0/0/0/0"
AIR = "/v1/seeds/42/chunks/0/0/9/0"
IMMUTABLE = "public, max-age=31536000, immutable"


@pytest.fixture(scope="module")
def client(server):
    with httpx2.Client(base_url=server.url) as client:
        yield client


def request(recipe, key, encoding):
    return ChunkRequest(WorldRecipe(42, builtin(recipe)), ChunkKey(*key), encoding=encoding)


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        (SURFACE, request("terrain", (0, 0, 0, 0), Encoding())),
        (f"{SURFACE}.mesh?profile=f32", request("terrain", (0, 0, 0, 0), Encoding(profile="f32"))),
        (f"{SURFACE}.glb?recipe=hills", request("hills", (0, 0, 0, 0), Encoding("glb"))),
        ("/v1/seeds/42/chunks/1/-1/0/-1.glb?recipe=sphere", request("sphere", (1, -1, 0, -1), Encoding("glb"))),
        (f"{AIR}.glb?frame=chunk", request("terrain", (0, 0, 9, 0), Encoding("glb", frame="chunk"))),
    ],
)
def test_the_bytes_are_those_of_the_pipeline(client, url, expected):
    chunk = build_chunk(expected)
    answer = client.get(url, headers={"Accept-Encoding": "identity"})
    assert (answer.status_code, answer.content) == (200, chunk.body)
    assert answer.headers["chunk-content"] == chunk.content
    assert int(answer.headers["content-length"]) == len(chunk.body)
    for coding in ("gzip", "zstd"):
        coded = client.get(url, headers={"Accept-Encoding": coding})
        assert (coded.content, coded.headers["content-encoding"]) == (chunk.body, coding)
        assert int(coded.headers["content-length"]) < len(chunk.body)
        assert coded.headers["etag"] != answer.headers["etag"]


def test_the_descriptor_has_the_errors_that_chunks_have(client):
    """In voxels; of as many levels as there are."""
    recipe = WorldRecipe(42, builtin("hills"))
    found = until(lambda: client.get("/v1/seeds/42?recipe=hills").json()["geometric_errors"], 60, "they are known")
    assert found == [geometric_error(recipe, lod) for lod in range(LOD_MAX + 1)]
    created = client.post(
        "/v1/worlds", json={"id": "rough", "seed": 1, "recipe": "hills", "voxel_size": 0.25, "lods": 3}
    )
    errors = client.get("/v1/worlds/rough").json()["geometric_errors"]
    assert errors == created.json()["geometric_errors"] == [geometric_error(recipe, lod) for lod in range(3)]
    file = client.get("/v1/worlds/rough/chunks/2/0/-1/0.mesh").content
    assert struct.unpack_from("<f", file, 56) == (errors[2] / 4,)
    client.delete("/v1/worlds/rough").raise_for_status()


def test_head_has_the_headers_of_get_and_no_body(client):
    for url in (
        SURFACE,
        f"{SURFACE}.glb",
        AIR,
        f"{AIR}.glb",
        "/v1/seeds/42",
        "/",
        "/about",
        "/livez",
        "/readyz",
        "/openapi.json",
        "/x",
    ):
        got, head = (ask(url, headers={"X-Request-Id": "mine"}) for ask in (client.get, client.head))
        for answer in (got, head):
            del answer.headers["date"]
            answer.headers.pop("x-request-id", None)  # what is answered out of memory has none
        assert (head.status_code, head.content) == (got.status_code, b""), url
        assert {name: head.headers[name] for name in head.headers} == {
            name: got.headers[name] for name in got.headers
        }, url


def test_an_empty_chunk(client):
    native, glb = client.get(AIR), client.get(f"{AIR}.glb")
    assert (native.status_code, native.content, native.headers["chunk-content"]) == (204, b"", "air")
    assert "content-length" not in native.headers
    assert (glb.status_code, glb.headers["chunk-content"]) == (200, "air")
    length = struct.unpack_from("<I", glb.content, 12)[0]
    assert "meshes" not in json.loads(glb.content[20 : 20 + length])
    deep = client.get("/v1/seeds/42/chunks/0/0/-3/0?recipe=hills")
    assert (deep.status_code, deep.headers["chunk-content"]) == (204, "rock")


@pytest.mark.parametrize("url", [SURFACE, f"{SURFACE}.glb", AIR])
def test_a_tag_once_seen_is_answered_without_a_body(client, url):
    fresh = client.get(url)
    for known in (fresh.headers["etag"], f'"other", W/{fresh.headers["etag"]}', "*"):
        again = client.get(url, headers={"If-None-Match": known})
        assert (again.status_code, again.content) == (304, b"")
        for name in ("etag", "cache-control", "vary"):
            assert again.headers[name] == fresh.headers[name]


def test_tags_tell_formats_and_worlds_apart(client):
    urls = [
        f"{SURFACE}{tail}" for tail in ("", ".glb", ".glb?frame=chunk", "?profile=f32", "?recipe=hills", "?seam=none")
    ]
    assert len({client.head(url).headers["etag"] for url in urls}) == len(urls)
    assert client.head(SURFACE).headers["etag"] == client.head(f"{SURFACE}.mesh").headers["etag"]


def test_the_generator_token(client):
    token = client.get("/v1/seeds/42").json()["generator"]
    assert client.get(f"{SURFACE}?g={token}").headers["cache-control"] == IMMUTABLE
    assert client.get(SURFACE).headers["cache-control"] == "no-cache"
    old = client.get(f"{SURFACE}?g={token[::-1]}")
    assert (old.status_code, old.json()["generator"]) == (410, token)


def test_many_at_once_each_get_their_own_chunk(client):
    keys = [(0, x, 0, z) for x in range(-4, 4) for z in range(-4, 4)] * 2
    with ThreadPoolExecutor(16) as threads:
        answers = list(threads.map(lambda key: client.get("/v1/seeds/42/chunks/{}/{}/{}/{}.glb".format(*key)), keys))
    for key, answer in zip(keys, answers, strict=True):
        assert answer.content == build_chunk(request("terrain", key, Encoding("glb"))).body


@pytest.mark.parametrize(
    ("method", "url", "status", "name"),
    [
        ("GET", "/nowhere", 404, "not-found"),
        ("GET", "/v1/seeds/42/", 404, "not-found"),
        ("GET", f"{SURFACE}.mesh%0A", 422, "bad-parameter"),
        ("GET", "/v1/recipes%0A", 404, "not-found"),
        ("GET", "/livez%0A", 404, "not-found"),
        ("GET", f"{SURFACE}%0A", 422, "bad-parameter"),
        ("GET", f"{SURFACE}/1", 404, "not-found"),
        ("POST", SURFACE, 405, "method-not-allowed"),
        ("DELETE", "/v1/seeds/42", 405, "method-not-allowed"),
        ("OPTIONS", "/livez", 405, "method-not-allowed"),
        ("GET", "/v1/seeds/42?nonsense=1", 422, "bad-parameter"),
        ("GET", f"{SURFACE}?coarser=64", 422, "bad-parameter"),
        ("GET", f"{SURFACE}?coarser=1&seam=skirts", 422, "bad-parameter"),
        ("GET", "/v1/seeds/42/chunks/20/0/0/0?coarser=1", 422, "bad-parameter"),
        ("GET", "/v1/seeds/42/chunks/0/0/0/%00", 422, "bad-parameter"),
        ("GET", "/v1/seeds/42/chunks/0/0/0/%ff", 422, "bad-parameter"),
        ("GET", "/v1/seeds/42/chunks/0/0/0/%D9%A1", 422, "bad-parameter"),
        ("GET", "/v1/seeds/42/chunks/30/0/0/0", 422, "bad-key"),
        ("GET", "/v1/seeds/42?recipe=nonsense", 422, "bad-recipe"),
        ("GET", f"{SURFACE}?g=0", 410, "old-generator"),
    ],
)
def test_every_error_is_a_problem(client, method, url, status, name):
    answer = client.request(method, url)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert answer.headers["cache-control"] == "no-store"
    body = answer.json()
    assert (body["type"], body["status"]) == (f"urn:chunkserver:problem:{name}", status)
    assert body["title"]
    assert body["detail"]
    if status == 405:
        assert set(answer.headers["allow"].split(", ")) == {"GET", "HEAD"}


def test_the_documentation_is_served(client):
    assert client.get("/openapi.json").json()["openapi"].startswith("3.1")
    assert "/openapi.json" in client.get("/docs").text
