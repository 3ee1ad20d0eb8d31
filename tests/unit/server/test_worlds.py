import json
import shutil

import apsw
import pytest

from chunkserver.errors import Overloaded
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.server.recipes import FIRST_CHUNK
from chunkserver.server.worlds import BODY_BYTES_MAX, PAGE_DEFAULT, PAGE_MAX
from chunkserver.store import catalogue
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.world import LODS_DEFAULT
from tests.unit.server.stub import StubPool, client_of

NEW = {"id": "w", "seed": 42, "recipe": "hills"}
TREE = {"op": "sphere", "radius": 20}


@pytest.fixture
def pool():
    return StubPool()


@pytest.fixture
def client(pool):
    with client_of(pool) as client:
        yield client


def test_a_new_world(client):
    answer = client.post("/v1/worlds", json=NEW)
    assert (answer.status_code, answer.headers["location"]) == (201, "/v1/worlds/w")
    found = answer.json()
    recipe = WorldRecipe(42, builtin("hills"))
    assert (found["id"], found["seed"], found["revision"]) == ("w", "42", "0")
    assert found["recipe"] == {"name": "hills", "digest": recipe.digest, "expression": json.loads(recipe.source)}
    assert (found["voxel_size"], found["lods"], found["chunk_cells"]) == (1.0, LODS_DEFAULT, 32)
    assert (found["generator"], found["durable"]) == (generator(recipe), False)
    assert found["limits"]["answer_seconds"] > 0
    got = client.get("/v1/worlds/w")
    assert got.json() == found
    assert got.headers["cache-control"] == "no-cache"


def test_a_world_has_all_that_a_seed_has(client):
    world = client.post("/v1/worlds", json=NEW).json()
    seed = client.get("/v1/seeds/42?recipe=hills").json()
    assert set(world) - set(seed) == {"id", "epoch", "revision", "created", "durable", "limits"}
    assert {name for name in seed if seed[name] != world[name]} == {"lods", "geometric_errors", "urls"}


def test_a_world_of_a_single_level_has_no_coarser_neighbours(client):
    assert client.post("/v1/worlds", json=NEW | {"lods": 1}).json()["coarser"] == [0]
    assert client.get("/v1/worlds/w/chunks/0/0/0/0").status_code == 200
    answer = client.get("/v1/worlds/w/chunks/0/0/0/0?coarser=1")
    assert (answer.status_code, answer.json()["coarser"]) == (422, 1)
    assert answer.json()["detail"] == "coarser is 1; nothing is coarser than lod 0 in this world"


@pytest.mark.parametrize("cells", [16, 32, 64])
def test_what_is_chosen(client, cells):
    chosen = {"voxel_size": 0.25, "lods": 3, "chunk_cells": cells}
    found = client.post("/v1/worlds", json=NEW | chosen).json()
    assert {name: found[name] for name in chosen} == chosen
    lattice = found["position_lattice"]
    assert lattice["units_per_voxel"] * cells == lattice["high"] - lattice["low"]


@pytest.mark.parametrize("seed", [-(2**63), 2**63 - 1, str(-(2**63)), str(2**63 - 1), 0, "0"])
def test_a_seed_is_a_number_or_a_string_and_never_rounded(client, seed):
    assert client.post("/v1/worlds", json=NEW | {"seed": seed}).json()["seed"] == str(seed)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("hills", "hills"),
        ({"builtin": "planet", "radius": 100}, None),
        (TREE, None),
        (7, None),
        ({"builtin": "hills"}, None),
    ],
)
def test_a_recipe_is_whatever_could_be_posted(client, given, name):
    found = client.post("/v1/worlds", json=NEW | {"recipe": given}).json()["recipe"]
    assert canonical(found["expression"]) == canonical(given)
    assert found["name"] == (name or found["digest"])
    assert client.get(f"/v1/recipes/{found['digest']}").status_code == 200


def test_a_recipe_by_its_digest(client, pool):
    digest = client.post("/v1/recipes", json=TREE).json()["digest"]
    built = len(pool.built)
    assert client.post("/v1/worlds", json=NEW | {"recipe": digest}).json()["recipe"]["name"] == digest
    assert len(pool.built) == built == 1
    unknown = client.post("/v1/worlds", json=NEW | {"id": "other", "recipe": digest[::-1]})
    assert (unknown.status_code, unknown.json()["recipe"]) == (404, digest[::-1])


def test_a_recipe_is_accepted_by_its_first_chunk(client, pool):
    pool.error = Overloaded("too many")
    assert client.post("/v1/worlds", json=NEW | {"recipe": TREE}).status_code == 503
    assert client.get("/v1/worlds/w").status_code == 404
    pool.error = None
    assert client.post("/v1/worlds", json=NEW | {"recipe": TREE}).status_code == 201
    assert [request.key for request in pool.built] == [FIRST_CHUNK] * 2
    assert pool.built[0].recipe.source == canonical(TREE)


def test_the_same_again_is_the_world_that_is_there(client):
    first = client.post("/v1/worlds", json=NEW)
    for same in (NEW, NEW | {"seed": "42", "lods": LODS_DEFAULT}, NEW | {"recipe": first.json()["recipe"]["digest"]}):
        again = client.post("/v1/worlds", json=same)
        assert (again.status_code, again.json()) == (200, first.json())
        assert again.headers["location"] == "/v1/worlds/w"


@pytest.mark.parametrize(
    ("other", "name"),
    [
        ({"seed": 43}, "recipe"),
        ({"recipe": "terrain"}, "recipe"),
        ({"voxel_size": 2}, "voxel_size"),
        ({"lods": 3}, "lods"),
        ({"chunk_cells": 16}, "chunk_cells"),
    ],
)
def test_other_content_under_the_same_id_is_refused(client, other, name):
    first = client.post("/v1/worlds", json=NEW).json()
    answer = client.post("/v1/worlds", json=NEW | other)
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:chunkserver:problem:world-exists")
    assert answer.json()["id"] == "w"
    assert name in answer.json()["detail"]
    assert client.get("/v1/worlds/w").json() == first


def test_a_deleted_world_is_gone_and_the_next_has_another_epoch(client):
    first = client.post("/v1/worlds", json=NEW).json()
    deleted = client.delete("/v1/worlds/w")
    assert (deleted.status_code, deleted.content) == (204, b"")
    for method in ("GET", "DELETE"):
        answer = client.request(method, "/v1/worlds/w")
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:chunkserver:problem:unknown-world")
        assert answer.json()["world"] == "w"
    again = client.post("/v1/worlds", json=NEW)
    assert again.status_code == 201
    assert again.json()["epoch"] != first["epoch"]


def test_the_list_is_in_pages(client):
    names = ["a", "a-", "b", "b_", "c"]
    for name in names[::-1]:
        client.post("/v1/worlds", json=NEW | {"id": name})
    page, seen, after = None, [], ""
    while page is None or page["next"]:
        page = client.get(f"/v1/worlds?limit=2{after}").json()
        assert (page["count"], len(page["worlds"]) <= 2, page["durable"]) == (5, True, False)
        seen += [world["id"] for world in page["worlds"]]
        after = f"&after={page['next']}"
    assert seen == names
    whole = client.get("/v1/worlds")
    assert ([world["id"] for world in whole.json()["worlds"]], whole.json()["next"]) == (names, None)
    assert whole.headers["cache-control"] == "no-cache"
    found = client.get("/v1/worlds/a").json()
    row = whole.json()["worlds"][0]
    assert row.pop("recipe") == "hills"
    assert row == {name: found[name] for name in row}
    assert len(client.get("/v1/worlds?limit=4").json()["worlds"]) == 4
    assert client.get("/v1/worlds?limit=5").json()["next"] is None, "there is no empty page"
    assert 5 < PAGE_DEFAULT <= PAGE_MAX


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"id": ""}, "id"),
        ({"id": "A"}, "id"),
        ({"id": "a\n"}, "id"),
        ({"id": "x" * 65}, "id"),
        ({"id": 7}, "id"),
        ({"seed": 1.5}, "seed"),
        ({"seed": 1.0}, "seed"),
        ({"seed": True}, "seed"),
        ({"seed": "+1"}, "seed"),
        ({"seed": None}, "seed"),
        ({"seed": "9" * 60_000}, "seed"),
        ({"voxel_size": 0}, "voxel_size"),
        ({"voxel_size": -1}, "voxel_size"),
        ({"voxel_size": 2.0**21}, "voxel_size"),
        ({"voxel_size": "1"}, "voxel_size"),
        ({"lods": 0}, "lods"),
        ({"lods": 22}, "lods"),
        ({"lods": "3"}, "lods"),
        ({"chunk_cells": 33}, "chunk_cells"),
        ({"chunk_cells": 2**70}, "chunk_cells"),
        ({"revision": 0}, "revision"),
        ({"epoch": "00"}, "epoch"),
    ],
)
def test_what_cannot_be_is_refused_by_name(client, pool, change, name):
    answer = client.post("/v1/worlds", json=NEW | change)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:chunkserver:problem:bad-parameter")
    assert name in answer.json()["detail"]
    assert name in answer.json()
    assert client.get("/v1/worlds").json()["count"] == 0
    assert not pool.built


@pytest.mark.parametrize("missing", NEW)
def test_what_is_missing_is_named(client, missing):
    answer = client.post("/v1/worlds", json={name: value for name, value in NEW.items() if name != missing})
    assert (answer.status_code, answer.json()["detail"][: len(missing)]) == (422, missing)


@pytest.mark.parametrize(
    ("recipe", "path"),
    [("nonsense", None), ("", None), (None, ""), ([], ""), ({"op": "sphere"}, "radius"), ({"builtin": "x"}, None)],
)
def test_a_bad_recipe_is_refused_by_its_path(client, recipe, path):
    answer = client.post("/v1/worlds", json=NEW | {"recipe": recipe})
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:chunkserver:problem:bad-recipe")
    assert answer.json().get("path") == path


@pytest.mark.parametrize("seed", [2**63, str(-(2**63) - 1)])
def test_a_seed_beyond_64_bits(client, seed):
    answer = client.post("/v1/worlds", json=NEW | {"seed": seed})
    assert (answer.status_code, answer.json()["seed"]) == (422, str(seed))


@pytest.mark.parametrize(
    ("content", "status"),
    [
        (b"", 422),
        (b"{", 422),
        (b"7", 422),
        (b"\xff\xfe", 422),
        (b'{"id":"w","seed":1,"recipe":NaN}', 422),
        (b'{"id":"w","seed":1,"recipe":{"op":"sphere","radius":Infinity}}', 422),
        (b'{"id":"w","seed":1,"recipe":"\\ud800"}', 422),
        (b'{"id":"w","seed":1,"recipe":' + b"[" * 30_000 + b"]" * 30_000 + b"}", 422),
        (b'{"id":"w","seed":1,"recipe":' + b'{"a":' * 10_000 + b"1" + b"}" * 10_000 + b"}", 422),
        (b'{"id":"w","seed":' + b"9" * 60_000 + b"}", 422),
        (b"{" + b" " * BODY_BYTES_MAX + b"}", 413),
    ],
)
def test_a_body_that_is_no_world(client, content, status):
    answer = client.post("/v1/worlds", content=content, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert client.get("/v1/worlds").json()["count"] == 0


def test_another_media_type(client):
    assert client.post("/v1/worlds", content=json.dumps(NEW)).status_code == 415


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("/v1/worlds/A", "world"),
        ("/v1/worlds/a%0A", "world"),
        ("/v1/worlds/w?x=1", "x"),
        ("/v1/worlds?limit=0", "limit"),
        (f"/v1/worlds?limit={PAGE_MAX + 1}", "limit"),
        ("/v1/worlds?limit=1&limit=1", "limit"),
        ("/v1/worlds?after=", "after"),
        ("/v1/worlds?after=A", "after"),
        ("/v1/worlds?before=a", "before"),
    ],
)
def test_a_malformed_url_is_refused_by_name(client, url, name):
    answer = client.get(url)
    assert answer.status_code == 422
    assert name in answer.json()


def test_there_is_no_room(client, monkeypatch):
    monkeypatch.setattr(catalogue, "WORLDS_MAX", 1)
    client.post("/v1/worlds", json=NEW)
    answer = client.post("/v1/worlds", json=NEW | {"id": "x"})
    assert (answer.status_code, answer.json()["type"]) == (507, "urn:chunkserver:problem:store-full")
    assert answer.json()["worlds_max"] == 1


def test_a_failure_of_the_disk_tells_no_path(tmp_path, caplog):
    with client_of(StubPool(), tmp_path / "worlds") as client:
        service = client.app.state.service  # type: ignore[attr-defined]
        service.worlds._store._database._writer.pragma("query_only", True)
        answer = client.post("/v1/worlds", json=NEW)
        assert (answer.status_code, answer.json()["type"]) == (500, "urn:chunkserver:problem:internal")
        assert str(tmp_path) not in answer.text
        assert str(tmp_path) in caplog.text
        assert client.get("/v1/worlds").json()["count"] == 0


def test_worlds_outlive_the_server(tmp_path):
    with client_of(StubPool(), tmp_path) as client:
        client.post("/v1/worlds", json=NEW)
        before = client.get("/v1/worlds/w").json()
        assert before["durable"] is True
    with client_of(StubPool(), tmp_path) as client:
        assert client.get("/v1/worlds/w").json() == before


def test_another_generator_serves_nothing_of_a_world_but_its_name(tmp_path):
    with client_of(StubPool(), tmp_path) as client:
        current = client.post("/v1/worlds", json=NEW).json()["generator"]
    connection = apsw.Connection(str(tmp_path / FILE_NAME))
    connection.execute("UPDATE worlds SET generator = '0123456789abcdef'")
    connection.close()
    with client_of(StubPool(), tmp_path) as client:
        for url in (
            "/v1/worlds/w",
            "/v1/worlds/w/chunks/0/0/0/0",
            "/v1/worlds/w/chunks/0/0/0/0.glb?g=0123456789abcdef",
        ):
            answer = client.get(url, headers={"If-None-Match": "*"})
            assert (answer.status_code, answer.json()["type"]) == (409, "urn:chunkserver:problem:other-generator")
            assert (answer.json()["created_by"], answer.json()["generator"]) == ("0123456789abcdef", current)
            for word in ("0123456789abcdef", current, "chunkserver migrate"):
                assert word in answer.json()["detail"]
        assert client.post("/v1/worlds", json=NEW).json()["type"] == "urn:chunkserver:problem:other-generator"
        assert (
            client.post("/v1/worlds", json=NEW | {"lods": 1}).json()["type"] == "urn:chunkserver:problem:world-exists"
        )
        (row,) = client.get("/v1/worlds").json()["worlds"]
        assert (row["id"], row["generator"]) == ("w", "0123456789abcdef")
        assert client.delete("/v1/worlds/w").status_code == 204


def test_a_closed_application_gives_the_folder_back(tmp_path):
    for _ in range(2):
        with client_of(StubPool(), tmp_path / "worlds"):
            pass
    shutil.rmtree(tmp_path / "worlds")
