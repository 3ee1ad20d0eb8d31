"""What the settings put together: layers and tiers that are there only when they are wanted."""

from contextlib import contextmanager

import pytest
from fastapi.testclient import TestClient

from chunkserver.errors import StoreError
from chunkserver.pipeline import Chunk
from chunkserver.server import Settings, create_app
from chunkserver.server.keys import mint
from tests.unit.server.stub import StubPool, app_of, client_of

CHUNK = "/v1/seeds/42/chunks/0/0/0/0.glb"
IMMUTABLE = f"{CHUNK}?g={{}}"


@contextmanager
def client_with(pool, **settings):
    plain = {"Accept-Encoding": "identity"}
    with TestClient(app_of(Settings(workers=1, **settings), pool), headers=plain) as client:
        yield client


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


def test_the_lifespan_starts_and_closes_the_pool():
    pool = StubPool()
    with client_of(pool):
        assert pool.life == ["start"]
    assert pool.life == ["start", "close"]


@pytest.mark.parametrize("anonymous", [False, True])
def test_keys_are_asked_for_in_front_of_everything(anonymous):
    reader, kept = mint("reader", "read")
    admin, kept_too = mint("admin", "admin")
    with client_with(StubPool(), api_keys=(kept, kept_too), anonymous_read=anonymous) as client:
        for _ in range(3):
            assert client.get(CHUNK, headers=bearer(reader)).status_code == 200
            assert client.get(CHUNK).status_code == (200 if anonymous else 401)
            assert client.get(CHUNK, headers=bearer("nonsense")).status_code == (200 if anonymous else 401)
        world = {"id": "w", "seed": 1, "recipe": "plane"}
        for headers, status in (({}, 401), (bearer(reader), 403), (bearer(admin), 201)):
            assert client.post("/v1/worlds", json=world, headers=headers).status_code == status
        generator = client.get("/v1/seeds/42", headers=bearer(reader)).json()["generator"]
        for _ in range(3):
            answer = client.get(IMMUTABLE.format(generator), headers=bearer(reader))
            shared = "public" if anonymous else "private"
            assert answer.headers["cache-control"] == f"{shared}, max-age=31536000, immutable"
        document = client.get("/openapi.json", headers=bearer(reader)).json()
        assert document["paths"]["/v1/worlds"]["post"]["security"]
        assert "401" in document["paths"]["/v1/worlds"]["post"]["responses"]
        assert client.get("/livez").status_code == 200
        metrics = client.get("/metrics", headers=bearer(reader)).text
        assert 'chunkserver_requests_total{method="POST",route="other",status="403"} 1.0' in metrics


def test_without_keys_nobody_is_asked(tmp_path):
    with client_with(StubPool(), data=tmp_path) as client:
        assert client.get(CHUNK, headers=bearer("anything")).status_code == 200
        assert "401" not in client.get("/openapi.json").text


def test_a_chunk_on_disk_outlives_the_server(tmp_path):
    pool = StubPool(Chunk("surface", b"of the first server"))
    for _ in range(2):
        with client_with(pool, disk_cache=tmp_path, disk_cache_bytes=1 << 24) as client:
            assert client.get(CHUNK).content == b"of the first server"
            pool.chunk = Chunk("surface", b"of the second")
    assert len(pool.built) == 1


def test_a_second_server_on_one_cache_is_refused(tmp_path):
    second = Settings(workers=1, disk_cache=tmp_path / "cache", data=tmp_path / "data")
    with client_with(StubPool(), disk_cache=tmp_path / "cache"):
        for _ in range(2):
            with pytest.raises(StoreError, match="cache"):
                create_app(second, StubPool())
    with client_with(StubPool(), disk_cache=second.disk_cache, data=second.data) as client:
        assert client.get(CHUNK).status_code == 200
