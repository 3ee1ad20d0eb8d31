"""Load as the benchmarks count it. How it is made, tests/loadtest holds."""

import asyncio

import pytest

from benchmarks import load
from benchmarks.load import Load, Request, offer, send, send_for
from tests.loadtest.stub import answer, answering, path

OK = answer("200 OK", b"hello")


@pytest.fixture(autouse=True)
def _short_load(monkeypatch):
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 5.0)


def test_every_request_is_sent_once_over_all_connections():
    paths = [f"/{number}" for number in range(50)]
    with answering(OK) as server:
        done = send(server.url, [Request(one) for one in paths], connections=4)
    assert sorted(map(path, server.requests)) == sorted(paths)
    assert server.open_most == 4
    assert (done.answers, done.bytes, dict(done.statuses)) == (50, 50 * len(OK), {"200": 50})
    assert done.latencies == sorted(done.latencies)
    assert done.seconds > 0 < done.cpu_seconds


def test_a_tag_is_sent():
    with answering(answer("304 Not Modified")) as server:
        done = send(server.url, [Request("/a", '"tag"')] * 2, connections=1)
    assert dict(done.statuses) == {"304": 2}
    assert all('\r\nIf-None-Match: "tag"\r\n' in request for request in server.requests)


def test_a_body_makes_it_a_post():
    with answering(OK) as server:
        send(server.url, [Request("/a", body=b"{}")], connections=1)
    assert server.requests[0].startswith("POST /a HTTP/1.1\r\n")
    assert "Content-Type: application/json\r\nContent-Length: 2\r\n" in server.requests[0]


def test_a_closed_loop_for_some_seconds_ends_with_its_answers():
    with answering(OK) as server:
        done = send_for(server.url, (Request(f"/{number}") for number in range(10**6)), connections=2, seconds=0.2)
    assert 0 < done.answers == len(server.requests) < 10**6
    assert server.open_most == 2
    assert done.seconds < 5.0


def test_a_request_without_an_answer_is_an_error():
    with answering([OK[:-1], b""]) as server, pytest.raises(ConnectionError, match="'cut': 2"):
        send(server.url, [Request("/a"), Request("/b")], connections=1)


def test_a_silent_server_is_an_error(monkeypatch):
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 0.2)
    with answering(OK[:-1]) as server:
        with pytest.raises(TimeoutError, match=r"within 0\.2 s"):
            send(server.url, [Request("/a")], connections=2)
        with pytest.raises(TimeoutError, match=r"within 0\.2 s"):
            offer(server.url, [Request("/a")], rate=100.0, seconds=0.1)


def test_quantiles_are_of_the_sorted_latencies():
    done = Load(latencies=[1.0, 2.0, 3.0, 4.0])
    assert [done.quantile(share) for share in (0, 0.5, 0.99, 1)] == [1.0, 3.0, 4.0, 4.0]


def test_an_open_loop_sends_as_many_as_are_due_and_counts_every_answer():
    with answering(OK) as server:
        done = offer(server.url, (Request(f"/{number}") for number in range(1000)), rate=200.0, seconds=0.5)
    assert (done.answers, dict(done.statuses), len(server.requests)) == (100, {"200": 100}, 100)
    assert done.seconds >= 0.49
    assert sorted(done.good_latencies) == done.latencies


def test_an_open_loop_goes_on_when_a_connection_ends_before_its_answer():
    with answering([OK[:-1], b""]) as server:
        done = offer(server.url, (Request("/") for _ in range(1000)), rate=100.0, seconds=0.3)
    assert (done.answers, dict(done.statuses)) == (0, {"cut": 30})


def test_an_open_loop_does_not_open_connections_for_ever(monkeypatch):
    monkeypatch.setattr(load, "OPEN_CONNECTIONS_MAX", 4)
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 0.3)
    with answering(OK[:-1]) as server, pytest.raises(TimeoutError):
        offer(server.url, (Request("/") for _ in range(1000)), rate=100.0, seconds=0.2)
    assert len(server.requests) == 4
    assert server.open_most == 4


def test_what_an_open_loop_does_not_send_is_counted(monkeypatch):
    async def slow(_head: str) -> bytes:
        await asyncio.sleep(0.4)
        return OK

    monkeypatch.setattr(load, "OPEN_CONNECTIONS_MAX", 4)
    with answering(slow) as server:
        done = offer(server.url, (Request("/") for _ in range(1000)), rate=100.0, seconds=0.2)
    assert dict(done.statuses) == {"200": 4, "unsent": 16}
