from tests.unit.server.stub import StubPool, client_of


def test_alive_but_not_ready_until_the_pool_is():
    pool = StubPool(ready=False)
    with client_of(pool) as client:
        assert client.get("/livez").json() == {"status": "alive"}
        answer = client.get("/readyz")
        assert answer.status_code == 503
        assert answer.json()["type"] == "urn:chunkserver:problem:unavailable"
        assert int(answer.headers["retry-after"]) > 0
        pool.ready = True
        answer = client.get("/readyz")
        assert (answer.status_code, answer.json()) == (200, {"status": "ready"})
        assert answer.headers["cache-control"] == "no-store"
