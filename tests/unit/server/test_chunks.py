import pytest

from chunkserver.errors import Overloaded
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.chunks import IMMUTABLE, REVALIDATE
from chunkserver.server.plan import VARY
from chunkserver.wire import CODINGS, Encoding
from tests.unit.server.stub import StubPool, client_of

URL = "/v1/seeds/42/chunks/3/1/-2/5"
AIR, ROCK = Chunk("air", b"not sent as .mesh"), Chunk("rock", b"not sent as .mesh")


@pytest.fixture
def pool():
    return StubPool()


@pytest.fixture
def client(pool):
    with client_of(pool) as client:
        yield client


def world(recipe):
    return WorldRecipe(42, builtin(recipe))


def token(client):
    return client.get("/v1/seeds/42").json()["generator"]


def test_the_url_says_what_is_built(client, pool):
    client.get(f"{URL}.glb?frame=chunk&recipe=hills&seam=none&mesher=marching-cubes&coarser=0")
    client.get(f"{URL}?profile=f32")
    client.get(f"{URL}.mesh?profile=f32&recipe=plane")
    client.get(f"{URL}?frame=chunk", headers={"Accept": "model/gltf-binary"})
    key = ChunkKey(3, 1, -2, 5)
    assert pool.built == [
        ChunkRequest(world("hills"), key, seam="none", encoding=Encoding("glb", frame="chunk")),
        ChunkRequest(world("terrain"), key, encoding=Encoding("mesh", "f32")),
        ChunkRequest(world("plane"), key, encoding=Encoding("mesh", "f32")),
        ChunkRequest(world("terrain"), key, encoding=Encoding("glb", frame="chunk")),
    ]


def test_nothing_is_built_twice_or_for_a_304(client, pool):
    first = client.get(URL)
    assert client.get(URL).content == first.content
    assert len(pool.built) == 1
    other = client.get(f"{URL}.glb").headers["etag"]
    for url, known in ((f"{URL}.glb", other), (f"{URL}?profile=f32", "*")):
        answer = client.get(url, headers={"If-None-Match": f'"x", W/{known}' if known != "*" else known})
        assert answer.status_code == 304
        assert not answer.content
        assert answer.headers["vary"] == VARY
        assert answer.headers["cache-control"] == REVALIDATE
        assert answer.headers["etag"].strip('"')
    assert len(pool.built) == 2
    assert client.get(URL, headers={"If-None-Match": other}).status_code == 200


def test_the_generator_token_makes_the_answer_immutable(client):
    fresh = client.get(f"{URL}?g={token(client)}")
    assert fresh.headers["cache-control"] == IMMUTABLE
    assert fresh.headers["etag"] == client.get(URL).headers["etag"]
    known = client.get(f"{URL}?g={token(client)}", headers={"If-None-Match": fresh.headers["etag"]})
    assert (known.status_code, known.headers["cache-control"]) == (304, IMMUTABLE)


@pytest.mark.parametrize("headers", [{}, {"If-None-Match": "*"}])
def test_another_generator_is_gone_and_the_current_one_named(client, pool, headers):
    answer = client.get(f"{URL}?g=0123456789abcdef", headers=headers)
    assert answer.status_code == 410
    assert answer.json()["generator"] == token(client)
    assert answer.json()["g"] == "0123456789abcdef"
    assert answer.headers["cache-control"] == "no-store"
    assert client.get(f"{URL}?recipe=hills&g={token(client)}").status_code == 410
    assert not pool.built


def test_the_extension_wins_over_accept(client):
    glb, native = "model/gltf-binary", "application/vnd.chunkserver.mesh"
    for url, accept, expected in (
        (URL, glb, glb),
        (URL, "*/*", native),
        (URL, "text/html", native),
        (f"{URL}.mesh", glb, native),
        (f"{URL}.glb", native, glb),
    ):
        answer = client.get(url, headers={"Accept": accept})
        assert (answer.headers["content-type"], answer.headers["vary"]) == (expected, VARY)


@pytest.mark.parametrize("chunk", [AIR, ROCK])
def test_an_empty_chunk(client, pool, chunk):
    pool.chunk = chunk
    native = client.get(f"{URL}.mesh")
    assert (native.status_code, native.content) == (204, b"")
    assert "content-type" not in native.headers
    glb = client.get(f"{URL}.glb")
    assert (glb.status_code, glb.content) == (200, chunk.body)
    for answer in (native, glb):
        assert answer.headers["chunk-content"] == chunk.content
        assert answer.headers["vary"] == VARY
        assert answer.headers["etag"]


@pytest.mark.parametrize(
    ("url", "name", "value"),
    [
        ("/v1/seeds/x/chunks/0/0/0/0", "seed", "x"),
        ("/v1/seeds/9223372036854775808/chunks/0/0/0/0", "seed", "9223372036854775808"),
        ("/v1/seeds/42/chunks/21/0/0/0", "lod", 21),
        ("/v1/seeds/42/chunks/-1/0/0/0", "lod", -1),
        ("/v1/seeds/42/chunks/0/34359738368/0/0", "x", 1 << 35),
        ("/v1/seeds/42/chunks/0/0/-34359738369/0", "y", -(1 << 35) - 1),
        ("/v1/seeds/42/chunks/0/0/0/99999999999999999", "z", "99999999999999999"),
        ("/v1/seeds/42/chunks/0/0/%20/0", "y", " "),
        ("/v1/seeds/42/chunks/0/0/0/0.obj", "z", "0.obj"),
        (f"{URL}?nonsense=1", "nonsense", "1"),
        (f"{URL}?revision=1", "revision", "1"),
        (f"{URL}?g=NOHEX", "g", "NOHEX"),
        (f"{URL}?g=", "g", ""),
        (f"{URL}?recipe=nonsense", "recipe", "nonsense"),
        (f"{URL}?mesher=nonsense", "mesher", "nonsense"),
        (f"{URL}?seam=walls", "seam", "walls"),
        (f"{URL}?coarser=64", "coarser", 64),
        (f"{URL}?coarser=1&seam=skirts", "coarser", 1),
        (f"{URL}?coarser=1&seam=none", "seam", "none"),
        ("/v1/seeds/42/chunks/20/0/0/0?coarser=1", "coarser", 1),
        (f"{URL}?coarser=one", "coarser", "one"),
        (f"{URL}?profile=nonsense", "profile", "nonsense"),
        (f"{URL}.glb?frame=nonsense", "frame", "nonsense"),
        (f"{URL}.glb?profile=std", "profile", "std"),
        (f"{URL}?frame=world", "frame", "world"),
        (f"{URL}?coarser=0&coarser=0", "coarser", "0"),
    ],
)
def test_what_cannot_be_answered_is_refused_by_name(client, pool, url, name, value):
    answer = client.get(url, headers={"If-None-Match": "*"})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()[name] == value
    assert name in answer.json()["detail"]
    assert not pool.built


@pytest.mark.parametrize(
    "last", ["0.", "0.obj", "0.glb.mesh", "0glb", "0.GLB", ".glb", "0.glb%20", "+0.glb", "-0.mesh"]
)
def test_what_is_no_last_part_of_a_url(client, last):
    answer = client.get(f"/v1/seeds/42/chunks/0/0/0/{last}")
    assert answer.status_code == 422
    assert answer.json()["z"] in last.replace("%20", " ")


def test_a_failed_build_is_tried_again(client, pool):
    pool.error = Overloaded("too many", waiting=256)
    answer = client.get(URL)
    assert (answer.status_code, answer.json()["waiting"]) == (503, 256)
    assert int(answer.headers["retry-after"]) > 0
    pool.error = None
    assert client.get(URL).status_code == 200


@pytest.mark.parametrize("coding", ["gzip", "zstd"])
def test_a_coding_is_a_variant_of_its_own(client, pool, coding):
    pool.chunk = Chunk("surface", CODINGS[coding].apply(b"a mesh"))
    plain = client.get(f"{URL}.glb").headers
    for _ in range(2):
        answer = client.get(f"{URL}.glb", headers={"Accept-Encoding": coding})
        assert (answer.headers["content-encoding"], answer.content) == (coding, b"a mesh")
        assert int(answer.headers["content-length"]) == len(pool.chunk.body)
        assert answer.headers["etag"] != plain["etag"]
    assert [request.encoding.coding for request in pool.built] == ["identity", coding]
    assert client.get(f"{URL}.glb").headers["etag"] == plain["etag"]
    assert "content-encoding" not in plain
    known = client.get(f"{URL}.glb", headers={"Accept-Encoding": coding, "If-None-Match": answer.headers["etag"]})
    assert (known.status_code, "content-encoding" in known.headers) == (304, False)


def test_what_has_no_body_has_no_coding(client, pool):
    pool.chunk = AIR
    answer = client.get(f"{URL}.mesh", headers={"Accept-Encoding": "gzip"})
    assert (answer.status_code, "content-encoding" in answer.headers) == (204, False)
