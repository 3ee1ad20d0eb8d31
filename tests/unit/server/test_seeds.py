import json

import pytest

from chunkserver.pipeline import generator
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.server.seeds import describe
from tests.unit.server.stub import StubPool, client_of


@pytest.fixture(scope="module")
def client():
    with client_of(StubPool()) as client:
        yield client


@pytest.mark.parametrize("recipe", BUILTINS)
def test_the_expression_is_one_that_a_user_could_have_posted(recipe):
    found = WorldRecipe(-7, builtin(recipe))
    described = describe(found, recipe, [1.0] * 21)
    assert canonical(described.recipe.expression) == found.source
    assert (described.recipe.digest, described.generator) == (found.digest, generator(found))


@pytest.mark.parametrize("seed", [-(2**63), 2**63 - 1])
def test_a_seed_is_never_rounded(client, seed):
    answer = client.get(f"/v1/seeds/{seed}")
    assert answer.json()["seed"] == str(seed)
    assert json.loads(answer.text, parse_int=float)["seed"] == str(seed)
    assert answer.headers["cache-control"] == "no-cache"


def test_its_urls_work_and_its_promises_are_kept(client):
    found = client.get("/v1/seeds/42?recipe=sphere").json()
    formats = {row["extension"]: row["media_type"] for row in found["formats"]}
    for name, cache_control in (("chunk", "no-cache"), ("chunk_immutable", "public, max-age=31536000, immutable")):
        for extension, media_type in formats.items():
            url = found["urls"][name].format(lod=found["lods"] - 1, x=0, y=-1, z=0, extension=extension)
            answer = client.get(url)
            assert (answer.status_code, answer.headers["content-type"]) == (200, media_type)
            assert answer.headers["cache-control"] == cache_control
    for mesher in found["meshers"]:
        for seam in found["seams"]:
            for coarser in found["coarser"]:
                answer = client.get(f"/v1/seeds/42/chunks/0/0/0/0?mesher={mesher}&seam={seam}&coarser={coarser}")
                assert answer.status_code == (422 if coarser and seam != "transitions" else 200)


def test_the_bounds_are_where_chunks_end(client):
    found = client.get("/v1/seeds/42").json()
    for lod in (0, found["lods"] - 1):
        side = found["chunk_cells"] << lod
        assert not any(bound % side for bound in found["bounds"]["min"] + found["bounds"]["max"])
        for axis in range(3):
            low, beyond = found["bounds"]["min"][axis] // side, found["bounds"]["max"][axis] // side
            for chunk, status in ((low, 200), (low - 1, 422), (beyond - 1, 200), (beyond, 422)):
                key = [0, 0, 0]
                key[axis] = chunk
                assert client.get(f"/v1/seeds/42/chunks/{lod}/{key[0]}/{key[1]}/{key[2]}").status_code == status
    assert client.get(f"/v1/seeds/42/chunks/{found['lods']}/0/0/0").status_code == 422


def test_the_position_lattice():
    lattice = describe(WorldRecipe(1, builtin("plane")), "plane", [1.0] * 21).position_lattice
    assert (lattice.high - lattice.low) / lattice.units_per_voxel == 32


def test_all_masks_are_built_but_at_the_last_level(client):
    assert client.get("/v1/seeds/42").json()["coarser"] == list(range(64))
    for mask in range(65):
        for lod, masks in ((0, 64), (19, 64), (20, 1)):
            status = client.get(f"/v1/seeds/42/chunks/{lod}/0/0/0?coarser={mask}").status_code
            assert status == (200 if mask < masks else 422)


@pytest.mark.parametrize("url", ["/v1/seeds/01", "/v1/seeds/1?mesher=marching-cubes", "/v1/seeds/1?recipe=x"])
def test_refused(client, url):
    assert client.get(url).status_code == 422
