import json

import pytest

from chunkserver.errors import BadRecipe, Overloaded
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.recipe.reading import SOURCE_BYTES_MAX
from chunkserver.server.chunks import IMMUTABLE, REVALIDATE
from chunkserver.server.posted import POSTED_MAX, digest_of
from chunkserver.server.recipes import BODY_BYTES_MAX
from tests.unit.server.stub import StubPool, client_of

TREE = {"op": "max", "a": {"op": "y"}, "b": {"op": "subtract", "a": 8, "b": {"op": "sphere", "radius": 20}}}
SOURCE = canonical(TREE)
DIGEST = digest_of(SOURCE)


@pytest.fixture
def pool():
    return StubPool()


@pytest.fixture
def client(pool):
    with client_of(pool) as client:
        yield client


def test_the_list(client):
    answer = client.get("/v1/recipes")
    found = answer.json()
    assert [row["name"] for row in found["recipes"]] == list(BUILTINS)
    for row in found["recipes"]:
        assert row["digest"] == digest_of(builtin(row["name"]))
        assert row["description"].endswith(".")
        assert "\n" not in row["description"]
    (planet,) = (row for row in found["recipes"] if row["name"] == "planet")
    radius = planet["parameters"]["radius"]
    assert canonical({"builtin": "planet", "radius": radius["default"]}) == builtin("planet")
    for outside in (radius.get("minimum", 0) / 2, 2 * radius["maximum"]):
        assert client.post("/v1/recipes", json={"builtin": "planet", "radius": outside}).status_code == 422
    assert answer.headers["cache-control"] == REVALIDATE


def test_the_list_counts_what_is_kept(client):
    before = client.get("/v1/recipes")
    assert before.json()["posted"].items() >= {"count": 0, "count_max": POSTED_MAX, "bytes": 0}.items()
    client.post("/v1/recipes", json=TREE)
    after = client.get("/v1/recipes", headers={"If-None-Match": before.headers["etag"]})
    assert after.json()["posted"]["count"] == 1
    assert after.json()["posted"]["bytes"] > len(SOURCE)


@pytest.mark.parametrize("name", BUILTINS)
def test_a_built_in_recipe_is_one_that_could_have_been_posted(client, pool, name):
    named, by_digest = client.get(f"/v1/recipes/{name}"), client.get(f"/v1/recipes/{digest_of(builtin(name))}")
    assert named.json()["name"] == name
    assert canonical(named.json()["expression"]) == builtin(name)
    assert named.json().items() >= by_digest.json().items()
    assert set(by_digest.json()) == {"digest", "expression"}
    assert (named.headers["cache-control"], by_digest.headers["cache-control"]) == (REVALIDATE, IMMUTABLE)
    answer = client.post("/v1/recipes", json=named.json()["expression"])
    assert (answer.status_code, answer.content) == (200, by_digest.content)
    assert not pool.built
    assert client.get("/v1/recipes").json()["posted"]["count"] == 0


def test_a_tag_once_seen_is_answered_without_a_body(client):
    client.post("/v1/recipes", json=TREE)
    for url in ("/v1/recipes", "/v1/recipes/terrain", f"/v1/recipes/{DIGEST}"):
        fresh = client.get(url)
        again = client.get(url, headers={"If-None-Match": fresh.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == fresh.headers["etag"]
        assert again.headers["cache-control"] == fresh.headers["cache-control"]
        assert client.get(url, headers={"If-None-Match": '"other"'}).content == fresh.content


def test_a_posted_recipe_works_everywhere(client, pool):
    answer = client.post("/v1/recipes", json=TREE)
    assert (answer.status_code, answer.headers["location"]) == (201, f"/v1/recipes/{DIGEST}")
    assert answer.json() == {"digest": DIGEST, "expression": json.loads(SOURCE)}
    assert client.get(answer.headers["location"]).content == answer.content
    found = client.get(f"/v1/seeds/7?recipe={DIGEST}").json()
    assert (found["recipe"]["name"], found["recipe"]["digest"]) == (DIGEST, DIGEST)
    for name in ("chunk", "chunk_immutable"):
        for extension in ("", ".glb", ".mesh"):
            url = found["urls"][name].format(lod=1, x=2, y=3, z=4, extension=extension)
            assert client.get(url).status_code == 200
    first, *others = pool.built
    assert first == ChunkRequest(WorldRecipe(0, SOURCE), ChunkKey(0, 0, 0, 0))
    assert len(others) == 2  # the routes without an extension and with .mesh are one chunk
    assert {request.recipe for request in others} == {WorldRecipe(7, SOURCE)}


@pytest.mark.parametrize(
    "given", [TREE, {"builtin": "planet", "radius": 6_400_000}, {"builtin": "hills"}, "hills", 3, {"op": "x"}]
)
def test_posting_twice_is_posting_once(client, given):
    first, second = (client.post("/v1/recipes", json=given) for _ in range(2))
    known = given in ("hills", {"builtin": "hills"})
    assert (first.status_code, second.status_code) == (200 if known else 201, 200)
    assert first.content == second.content
    assert first.headers["location"] == second.headers["location"]
    assert first.json()["digest"] == digest_of(canonical(given))


@pytest.mark.parametrize("url", ["/v1/recipes/{}", "/v1/seeds/1?recipe={}", "/v1/seeds/1/chunks/0/0/0/0.glb?recipe={}"])
def test_a_digest_that_is_not_kept(client, pool, url):
    answer = client.get(url.format(DIGEST), headers={"If-None-Match": "*"})
    assert (answer.status_code, answer.json()["type"]) == (404, "urn:chunkserver:problem:unknown-recipe")
    assert answer.json()["recipe"] == DIGEST
    assert "post it again" in answer.json()["detail"]
    assert not pool.built
    client.post("/v1/recipes", json=TREE)
    assert client.get(url.format(DIGEST)).status_code == 200


def test_a_name_of_nothing_is_not_found(client):
    answer = client.get("/v1/recipes/nonsense")
    assert (answer.status_code, answer.json()["recipe"]) == (404, "nonsense")
    assert "terrain" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("error", "status"),
    [(BadRecipe("too many registers", registers=99), 422), (Overloaded("too many", waiting=9), 503)],
)
def test_what_cannot_be_built_is_not_kept(client, pool, error, status):
    pool.error = error
    answer = client.post("/v1/recipes", json=TREE)
    assert answer.status_code == status
    assert answer.json().items() >= error.values.items()
    assert client.get("/v1/recipes").json()["posted"]["count"] == 0
    assert client.get(f"/v1/recipes/{DIGEST}").status_code == 404
    pool.error = None
    assert client.post("/v1/recipes", json=TREE).status_code == 201


@pytest.mark.parametrize(
    ("given", "path", "expected"),
    [
        ({"op": "max", "a": 1, "b": {"op": "sphere", "radius": -1}}, "b.radius", "should be greater than"),
        ({"op": "max", "a": 1}, "b", "should be there"),
        ({"op": "nonsense"}, "", "known op"),
        ({"builtin": "planet", "radius": "wide"}, "radius", "number"),
        ([1], "", "should be a node"),
    ],
)
def test_a_bad_tree_is_refused_by_its_path(client, pool, given, path, expected):
    answer = client.post("/v1/recipes", json=given)
    assert answer.status_code == 422
    assert answer.json()["type"] == "urn:chunkserver:problem:bad-recipe"
    assert answer.json()["path"] == path
    assert expected in answer.json()["detail"]
    assert not pool.built


@pytest.mark.parametrize(
    ("content", "status"),
    [(b"", 422), (b"{", 422), (b"NaN", 422), (b"\xff\xfe\xfd", 422), (b"1" + b" " * BODY_BYTES_MAX, 413)],
)
def test_a_body_that_is_no_recipe(client, content, status):
    answer = client.post("/v1/recipes", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"


def test_another_media_type(client):
    assert client.post("/v1/recipes", content=b"1").status_code == 415


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_parameter_is_refused(client, method):
    answer = client.request(method, "/v1/recipes?seed=1", **({"json": 1} if method == "POST" else {}))
    assert (answer.status_code, answer.json()["seed"]) == (422, "1")


def test_the_limits_agree():
    assert BODY_BYTES_MAX == SOURCE_BYTES_MAX
