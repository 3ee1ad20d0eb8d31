"""What pages of other sites are told, and that nobody else's answer depends on them."""

import asyncio

import pytest

from chunkserver.server.cors import Cors, CorsLayer
from tests.unit.server.stub import StubPool, client_of

PAGE, OTHER = "https://game.example", "https://evil.example"
CHUNK, BATCH, WORLDS = "/v1/seeds/42/chunks/0/0/0/0", "/v1/seeds/42/chunks", "/v1/worlds"


@pytest.fixture(scope="module")
def client():
    with client_of(StubPool()) as client:
        yield client


def preflight(client, path, method="GET", origin=PAGE):
    return client.options(path, headers={"Origin": origin, "Access-Control-Request-Method": method})


@pytest.mark.parametrize("headers", [{}, {"Origin": PAGE}])
@pytest.mark.parametrize("path", [CHUNK, "/v1/seeds/42", "/v1/seeds/x", "/nowhere"])
def test_anybody_may_read_and_a_cache_may_share_it(client, path, headers):
    for _ in range(3):
        answer = client.get(path, headers=headers)
        assert answer.headers["access-control-allow-origin"] == "*"
        assert answer.headers["access-control-expose-headers"] == "*"
        assert "Origin" not in answer.headers.get("vary", "")


@pytest.mark.parametrize(
    ("path", "methods"), [(CHUNK, "GET, HEAD"), (WORLDS, "GET, HEAD"), (BATCH, "GET, HEAD, POST"), ("/", "GET, HEAD")]
)
def test_any_page_may_read_and_none_may_write(client, path, methods):
    answer = preflight(client, path, "DELETE")
    assert (answer.status_code, answer.content) == (204, b"")
    assert answer.headers["access-control-allow-methods"] == methods
    assert "If-None-Match" in answer.headers["access-control-allow-headers"]
    assert int(answer.headers["access-control-max-age"]) > 0


def test_options_that_is_no_preflight_is_a_method_like_others(client):
    answer = client.options(CHUNK, headers={"Origin": PAGE})
    assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD")


def test_named_pages_alone():
    cors = Cors([PAGE])
    for origin in (None, OTHER.encode()):
        assert cors.headers(origin) == ((b"vary", b"Origin"),)
    assert dict(cors.headers(PAGE.encode()))[b"access-control-allow-origin"] == PAGE.encode()
    assert (b"vary", b"Origin") in cors.headers(PAGE.encode())
    assert b"access-control-allow-methods" not in dict(cors.preflight(OTHER.encode(), WORLDS))
    assert b"DELETE" in dict(cors.preflight(PAGE.encode(), WORLDS))[b"access-control-allow-methods"]


def test_any_page_beside_a_named_one_may_not_write():
    cors = Cors(["*", PAGE])
    assert cors.headers(None) == cors.headers(PAGE.encode()) == cors.headers(OTHER.encode())
    assert dict(cors.preflight(OTHER.encode(), WORLDS))[b"access-control-allow-methods"] == b"GET, HEAD"
    assert b"POST" in dict(cors.preflight(PAGE.encode(), WORLDS))[b"access-control-allow-methods"]


def test_nobody():
    assert Cors([]).headers(PAGE.encode()) == () == Cors([]).preflight(PAGE.encode(), BATCH)


def test_what_is_no_http_is_handed_on():
    seen = []

    async def app(scope, _receive, _send):
        seen.append(scope)

    async def nothing(*_):
        raise AssertionError("nobody asks or answers")

    asyncio.run(CorsLayer(app, Cors(["*"]))({"type": "lifespan"}, nothing, nothing))
    assert seen == [{"type": "lifespan"}]
