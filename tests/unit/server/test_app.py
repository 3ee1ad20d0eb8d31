from tests.unit.server.stub import StubPool, client_of


def test_the_lifespan_starts_and_closes_the_pool():
    pool = StubPool()
    with client_of(pool):
        assert pool.life == ["start"]
    assert pool.life == ["start", "close"]
