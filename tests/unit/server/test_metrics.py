import asyncio
import re

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics
from prometheus_client.parser import text_string_to_metric_families as text

from chunkserver.errors import BadParameter, BadStroke, StoreError, StoreFull
from chunkserver.server import Settings, create_app
from chunkserver.server.disk import DiskCache
from chunkserver.server.edit_counts import EditCounts
from chunkserver.server.histogram import SECONDS
from chunkserver.server.metrics import TABLE, _Reading
from chunkserver.server.pool import Pool, Tally
from tests.unit.server.stub import StubPool, client_of

CHUNK = "/v1/seeds/42/chunks/0/0/0/0.mesh"
UNITS = ("seconds", "bytes", "info")


@pytest.fixture
def client():
    with client_of(StubPool()) as client:
        yield client


def read(client, accept="text/plain", parse=text):
    answer = client.get("/metrics", headers={"Accept": accept})
    assert answer.status_code == 200
    return {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in parse(answer.text)
        for sample in family.samples
    }


def full_service(tmp_path):
    """A service that has every part, none of them started."""
    service = create_app(Settings(workers=1)).state.service
    assert isinstance(service.pool, Pool)
    service.cache.disk = DiskCache(tmp_path, 1 << 20)
    service.connections.count("idle")
    service.streams.closed[1000] = 1
    service.worlds.edits.counts.refused[StoreFull] += 1
    service.requests.count("/metrics", "GET", 200, 0.001)
    return service


@pytest.mark.parametrize(
    ("accept", "media_type", "parse"),
    [
        ("", "text/plain; version=0.0.4", text),
        ("*/*", "text/plain; version=0.0.4", text),
        ("application/openmetrics-text", "application/openmetrics-text; version=1.0.0", openmetrics),
        (
            "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.3,*/*;q=0.1",
            "application/openmetrics-text; version=1.0.0",
            openmetrics,
        ),
        ("application/json", "text/plain; version=0.0.4", text),
    ],
)
def test_in_the_format_that_is_wanted(client, accept, media_type, parse):
    answer = client.get("/metrics", headers={"Accept": accept})
    assert answer.headers["content-type"].startswith(media_type)
    assert answer.headers["content-type"].endswith("charset=utf-8")
    assert (answer.headers["cache-control"], answer.headers["vary"]) == ("no-store", "Accept")
    assert read(client, accept, parse)[("chunkserver_ready",)] == 1


def test_head(client):
    answer = client.head("/metrics")
    assert (answer.status_code, answer.content) == (200, b"")


def test_requests_are_counted(client):
    client.get(CHUNK)
    client.get(CHUNK)
    client.get(CHUNK, headers={"If-None-Match": "*"})
    client.get(CHUNK.replace("/0.mesh", "/1.mesh"))
    client.get("/v1/seeds/x")
    client.get("/nothing/here")
    found = read(client)
    template = "/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}.mesh"
    name = "chunkserver_requests_total"
    assert found[name, ("method", "GET"), ("route", template), ("status", "200")] == 1
    assert found[name, ("method", "GET"), ("route", "/v1/seeds/{seed}"), ("status", "422")] == 1
    assert found[name, ("method", "GET"), ("route", "other"), ("status", "404")] == 1
    for kind, times in {"found": 1, "not_modified": 1, "built": 1, "refused": 0}.items():
        assert found["chunkserver_front_answers_total", ("kind", kind)] == times
    assert found["chunkserver_request_seconds_count", ("route", template)] == 1
    assert found["chunkserver_requests_in_flight",] == 1, "this one"
    assert found["chunkserver_cache_misses_total",] == 2
    assert found["chunkserver_cache_chunks",] == 2
    assert found["chunkserver_cache_bytes",] > 0
    assert found["process_resident_memory_bytes",] > 1 << 20


def test_a_histogram_adds_up(client):
    service = client.app.state.service
    for seconds in (0.00005, 0.0001, 0.3, 100.0):
        service.requests.count("r", "GET", 200, seconds)
    found = read(client)
    name, route = "chunkserver_request_seconds", ("route", "r")
    buckets = [found[f"{name}_bucket", ("le", str(bound)), route] for bound in SECONDS]
    assert buckets == [2 if bound < 0.3 else 3 for bound in SECONDS]
    assert found[f"{name}_bucket", ("le", "+Inf"), route] == found[f"{name}_count", route] == 4
    assert found[f"{name}_sum", route] == pytest.approx(100.30015)


def test_what_there_is_not_has_no_lines(client):
    names = {name for name, *_ in read(client)}
    assert not [name for name in names if name.startswith(("chunkserver_disk", "chunkserver_jobs"))]
    assert "chunkserver_cache_hits_total" in names


def test_every_row_is_read(tmp_path):
    service = full_service(tmp_path)
    try:
        found = {sample.name for family in _Reading(service).collect() for sample in family.samples}
    finally:
        asyncio.run(service.cache.close())
        asyncio.run(service.worlds.close())
    for row in TABLE:
        assert row.name + ("_count" if row.kind == "histogram" else "") in found, row.name


def test_all_that_the_pool_counts_is_told(tmp_path):
    service = full_service(tmp_path)
    numbers = {name: number for number, name in enumerate(Tally.__slots__, 1000) if name != "seconds"}
    for name, number in numbers.items():
        setattr(service.pool.tally, name, number)
    told = {value for row in TABLE for value in row.read(service).values() if isinstance(value, int)}
    asyncio.run(service.cache.close())
    asyncio.run(service.worlds.close())
    assert set(numbers.values()) <= told


def test_all_that_is_counted_of_edits_is_told(client):
    counts = client.app.state.service.worlds.edits.counts
    seconds = {"write_seconds", "fold_seconds"}
    numbers = {name: number for number, name in enumerate(EditCounts.__slots__, 1000) if name not in seconds}
    del numbers["refused"]
    for name, number in numbers.items():
        setattr(counts, name, number)
    counts.write_seconds.observe(0.002)
    counts.fold_seconds.observe(0.3)
    for kind in (BadStroke, BadParameter, StoreError, StoreError):
        with pytest.raises(kind), counts.refusals():
            raise kind("no")
    found = read(client)
    assert {value for name, value in found.items() if name[0].startswith("chunkserver")} >= set(numbers.values())
    assert (found["chunkserver_edit_seconds_sum",], found["chunkserver_fold_seconds_sum",]) == (0.002, 0.3)
    refused = {key[1][1]: value for key, value in found.items() if key[0] == "chunkserver_edits_refused_total"}
    assert refused == {"bad-stroke": 1, "bad-parameter": 1, "internal": 2}


def test_names_are_those_of_prometheus():
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    for row in TABLE:
        assert re.fullmatch(r"chunkserver(_[a-z]+)+", row.name), row.name
        assert row.name.endswith("_total") == (row.kind == "counter"), row.name
        assert row.kind in ("counter", "gauge", "histogram")
        assert row.kind != "histogram" or row.name.endswith(UNITS)
        assert row.says.endswith("."), row.name
        assert not {"le", "quantile"} & set(row.labels)
