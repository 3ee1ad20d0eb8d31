"""More requests than can be built: each is answered well or refused at once, and afterwards all is as before.

How much is still answered well, and how late, is a matter of the machine: `benchmarks/overload.py` measures that.
"""

import asyncio

import httpx2
import pytest

from tests.scale import count
from tests.serving import serving

JOBS_WAITING = 8
REQUESTS = count(20_000)
IDENTICAL = 100
COSTLY = {
    "op": "subtract",
    "a": {"op": "y"},
    "b": {"op": "fbm3", "frequency": 0.05, "octaves": 14, "gain": 0.9, "lacunarity": 1.1},
}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    options = ("--workers", "1", "--jobs-waiting", str(JOBS_WAITING))
    with serving(tmp_path_factory.mktemp("server") / "log", *options) as running:
        yield running


def counter(server, name):
    (line,) = [line for line in httpx2.get(f"{server.url}/metrics").text.splitlines() if line.startswith(f"{name} ")]
    return float(line.split()[1])


async def answers_of(server, urls):
    limits = httpx2.Limits(max_connections=200)
    async with httpx2.AsyncClient(base_url=server.url, limits=limits, timeout=60.0) as client:
        return await asyncio.gather(*(client.get(url) for url in urls))


def test_what_is_too_much_is_refused_and_nothing_else(server):
    digest = httpx2.post(f"{server.url}/v1/recipes", json=COSTLY).raise_for_status().json()["digest"]
    urls = [f"/v1/seeds/1/chunks/0/{x}/0/0?recipe={digest}" for x in range(REQUESTS)]
    answers = asyncio.run(answers_of(server, urls))
    refused = [answer for answer in answers if answer.status_code == 503]
    built = [answer for answer in answers if answer.status_code in (200, 204)]
    assert len(refused) + len(built) == REQUESTS
    assert refused, "a queue of this length is full at once"
    assert len(built) > JOBS_WAITING
    for answer in refused:
        assert answer.json()["type"] == "urn:chunkserver:problem:overloaded"
        assert int(answer.headers["retry-after"]) > 0
        assert answer.headers["cache-control"] == "no-store"
    assert counter(server, "chunkserver_jobs_waiting") == 0
    again = asyncio.run(answers_of(server, [str(refused[0].url), str(built[0].url)]))
    assert [answer.status_code for answer in again] == [200, 200]


def test_identical_requests_are_one_build(server):
    before = counter(server, "chunkserver_cache_misses_total")
    answers = asyncio.run(answers_of(server, ["/v1/seeds/77/chunks/0/0/0/0.glb"] * IDENTICAL))
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.content for answer in answers}) == 1
    assert counter(server, "chunkserver_cache_misses_total") == before + 1
