"""What is sent when, what is counted, and that nothing is unbounded."""

import asyncio
import itertools
import socket
import time
from collections import Counter
from collections.abc import Iterator

import pytest

from chunkserver_loadtest.errors import BadOption, BadTarget
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.exchange import Exchange, Request
from chunkserver_loadtest.generator import Limits, Observer, Schedule, offer, saturate
from chunkserver_loadtest.record import Record
from chunkserver_loadtest.target import resolve
from tests.loadtest.stub import OK, TAG, answer, answering, path

HELLO = answer("200 OK", b"hello")


class Ledger(Observer):
    """Writes everything down."""

    def __init__(self) -> None:
        self.exchanges: list[Exchange] = []
        self.not_sent: list[Exchange] = []
        self.asked: list[Exchange] = []
        self.waited = 0
        self.in_flight_most = 0

    def due(self, exchange: Exchange, waits: bool, in_flight: int) -> None:
        self.asked.append(exchange)
        self.waited += waits
        self.in_flight_most = max(self.in_flight_most, in_flight)

    def unsent(self, exchange: Exchange) -> None:
        self.not_sent.append(exchange)

    def ended(self, exchange: Exchange) -> None:
        self.exchanges.append(exchange)

    @property
    def statuses(self) -> Counter[str]:
        return Counter(exchange.status for exchange in self.exchanges)


def at_rate(rate: float, requests: Iterator[Request] | None = None) -> Schedule:
    asked = requests or (Request(f"/{number}") for number in itertools.count())
    return ((number / rate, request) for number, request in enumerate(asked))


def offered(url: str, schedule: Schedule, limits: Limits, closed: bool = False) -> Ledger:
    ledger = Ledger()
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        target = resolve(url)
        if closed:
            runner.run(saturate(target, (request for _, request in schedule), limits, ledger))
        else:
            runner.run(offer(target, schedule, limits, ledger))
    return ledger


def test_as_many_are_sent_as_are_due_each_once():
    with answering(HELLO) as server:
        ledger = offered(server.url, at_rate(200), Limits(seconds=0.5, connections=4))
    assert ledger.statuses == {"200": 100}
    assert sorted(map(path, server.requests)) == sorted(f"/{number}" for number in range(100))
    assert server.open_most == 4
    assert all(exchange.due <= exchange.sent <= exchange.ended for exchange in ledger.exchanges)


def test_a_closed_loop_asks_when_it_has_its_answer():
    with answering(HELLO) as server:
        ledger = offered(server.url, at_rate(1), Limits(seconds=30, requests=50, connections=4), closed=True)
    assert ledger.statuses == {"200": 50}
    assert len(set(server.requests)) == 50
    assert ledger.in_flight_most == 4


def test_a_request_says_what_it_is_asked_to():
    request = Request("/a?b=c", etag=TAG, urgency=2, coding="zstd")
    with answering(HELLO) as server:
        offered(server.url, [(0.0, request), (0.01, Request("/batch", body=b'{"chunks": []}'))], Limits(seconds=1))
    first, second = server.requests
    host = server.url.removeprefix("http://")
    assert first.splitlines()[0] == "GET /a?b=c HTTP/1.1"
    assert {f"Host: {host}", f"If-None-Match: {TAG}", "Priority: u=2", "Accept-Encoding: zstd"} <= set(
        first.splitlines()
    )
    assert second.startswith("POST /batch ")
    assert "Content-Length: 14" in second


@pytest.mark.parametrize("cut", [1, 20, len(HELLO) - 5, len(HELLO) - 1])
def test_an_answer_may_come_in_pieces(cut):
    with answering([HELLO[:cut], HELLO[cut:]]) as server:
        ledger = offered(server.url, at_rate(20), Limits(seconds=0.1))
    assert [exchange.answer.body for exchange in ledger.exchanges if exchange.answer] == [b"hello"] * 2


def test_header_fields_are_found_whatever_their_case():
    told = b'HTTP/1.1 200 OK\r\nX-ETag: 1\r\nETag:  "Two" \r\nContent-Length: 5\r\nEmpty:\r\n\r\netag:'
    with answering(told) as server:
        ledger = offered(server.url, at_rate(20), Limits(seconds=0.05))
    found = ledger.exchanges[0].answer
    assert found
    assert [found.text(name) for name in (b"etag", b"x-etag", b"empty", b"age")] == ['"Two"', "1", "", ""]
    assert found.body == b"etag:"
    assert ledger.exchanges[0].received == len(told)


def test_a_head_without_an_end_is_too_large():
    with answering(b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 20_000) as server:
        ledger = offered(server.url, at_rate(20), Limits(seconds=0.05))
    assert ledger.statuses == {"too-large": 1}


@pytest.mark.parametrize(
    ("reply", "failure"),
    [
        (b"", "closed"),
        ([HELLO[:30], b""], "cut"),
        ([HELLO[:-1], b""], "cut"),
        (HELLO + b"more", "extra-bytes"),
        (HELLO + HELLO, "extra-bytes"),
        (b"HTTP/1.1 200 OK\r\ncontent-length: no\r\n\r\n", "malformed-http"),
        (b"SMTP ready\r\n\r\n", "malformed-http"),
    ],
)
def test_what_is_no_answer_is_counted(reply, failure):
    with answering(reply) as server:
        ledger = offered(server.url, at_rate(50), Limits(seconds=0.2, connections=2))
    assert ledger.statuses == {failure: 10}


def test_an_answer_that_does_not_end_is_counted():
    with answering(answer("200 OK", b"hello", length="6")) as server:
        ledger = offered(server.url, at_rate(50), Limits(seconds=0.1, connections=8, timeout=0.3))
    assert ledger.statuses == {"timeout": 5}
    assert "0.3 s" in ledger.exchanges[0].detail
    assert ledger.exchanges[0].service >= 0.3


def test_bytes_after_an_answer_are_counted_when_they_come_late():
    with answering([HELLO, b"more"]) as server:
        ledger = offered(server.url, at_rate(2), Limits(seconds=1.5, connections=1))
    assert ledger.statuses["200"] == 3
    assert ledger.statuses["extra-bytes"] >= 2


def test_a_connection_that_is_closed_after_each_answer_is_opened_again():
    with answering(answer("200 OK", b"hello", connection="close")) as server:
        ledger = offered(server.url, at_rate(100), Limits(seconds=0.3, connections=2))
    assert ledger.statuses == {"200": 30}


def test_a_closed_loop_keeps_its_connections():
    with answering(answer("200 OK", b"hello", connection="close")) as server:
        ledger = offered(server.url, at_rate(1), Limits(seconds=30, requests=80, connections=4), closed=True)
    assert ledger.statuses == {"200": 80}
    assert sum(exchange.sent > 0 for exchange in ledger.asked) == len(server.requests) == 80
    assert ledger.in_flight_most == 4


def test_a_closed_loop_ends_when_the_server_has_gone_away():
    with answering(HELLO) as server:

        def stopping() -> Iterator[tuple[float, Request]]:
            for number in itertools.count():
                if number == 30:
                    server.stop()
                yield 0.0, Request("/")

        started = time.perf_counter()
        ledger = offered(server.url, stopping(), Limits(seconds=30, connections=3, timeout=2), closed=True)
    assert time.perf_counter() - started < 10
    assert ledger.statuses["200"] >= 20
    assert 1 <= ledger.statuses["no-connection"] <= 3
    assert ledger.statuses.total() < 40


def test_in_flight_is_bounded_below_the_connections_too():
    async def slow(_head: str) -> bytes:
        await asyncio.sleep(0.3)
        return OK

    with answering(slow) as server:
        ledger = offered(server.url, at_rate(100), Limits(seconds=0.1, connections=8, in_flight=3))
    assert (ledger.in_flight_most, len(ledger.not_sent), ledger.statuses) == (3, 7, {"200": 3})


def test_a_server_that_goes_away_fails_what_is_due():
    with answering(HELLO) as server:

        def stopping() -> Iterator[tuple[float, Request]]:
            for number, due in enumerate(at_rate(100)):
                if number == 20:
                    server.stop()
                yield due

        ledger = offered(server.url, stopping(), Limits(seconds=0.6, connections=2, timeout=1))
    assert len(ledger.exchanges) == 60
    assert ledger.statuses["200"] >= 1
    assert ledger.statuses["no-connection"] >= 30


def test_more_than_the_server_can_is_bounded_in_flight_and_time():
    async def slow(_head: str) -> bytes:
        await asyncio.sleep(0.05)
        return OK

    limits = Limits(seconds=0.5, connections=4, in_flight=40, timeout=0.5)
    with answering(slow) as server:
        started = time.perf_counter()
        ledger = offered(server.url, at_rate(2000), limits)
        took = time.perf_counter() - started
    assert took < limits.seconds + limits.timeout + 1
    assert ledger.in_flight_most == 40
    assert server.open_most == 4
    assert len(ledger.not_sent) + len(ledger.exchanges) == 1000
    assert len(ledger.not_sent) > 800
    assert ledger.waited >= len(ledger.asked) - 80


def test_what_still_waits_at_the_end_is_unsent_and_what_is_asked_has_failed():
    async def never(_head: str) -> bytes:
        await asyncio.sleep(60)
        return OK

    with answering(never) as server:
        ledger = offered(server.url, at_rate(100), Limits(seconds=0.2, connections=3, timeout=0.2))
    assert len(ledger.not_sent) + len(ledger.exchanges) == 20
    assert set(ledger.statuses) == {"timeout"}


def test_no_server_is_an_error():
    with answering(HELLO) as server:
        url = server.url
    with pytest.raises(BadTarget, match="no connection to 127"):
        offered(url, at_rate(1), Limits(seconds=0.1))


def test_a_fault_of_a_schedule_ends_the_load():
    def broken() -> Iterator[tuple[float, Request]]:
        yield 0.0, Request("/")
        yield 0.05, Request("/")
        raise RuntimeError("a schedule is broken")

    with answering(HELLO) as server, pytest.raises(RuntimeError, match="a schedule is broken"):
        offered(server.url, broken(), Limits(seconds=5))


def test_a_fault_of_an_observer_ends_the_load():
    class Broken(Record):
        def ended(self, exchange: Exchange) -> None:
            raise RuntimeError(f"an observer is broken by {exchange.status}")

    with (
        answering(HELLO) as server,
        asyncio.Runner(loop_factory=new_event_loop) as runner,
        pytest.raises(RuntimeError, match="an observer is broken"),
    ):
        runner.run(offer(resolve(server.url), at_rate(10), Limits(seconds=5), Broken()))


@pytest.mark.parametrize(
    "wrong",
    [{"seconds": 0}, {"seconds": 1e9}, {"requests": 0}, {"connections": 5000}, {"in_flight": 0}, {"timeout": -1}],
)
def test_limits_are_limited(wrong):
    with pytest.raises(BadOption, match=next(iter(wrong))):
        Limits(**wrong)


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("ftp://127.0.0.1", "no URL of a server"),
        ("127.0.0.1:8000", "no URL of a server"),
        ("http://127.0.0.1:99999", "no URL"),
        ("http://192.0.2.1:8000", "--allow-remote"),
        ("http://[2001:db8::1]:8000", "--allow-remote"),
    ],
)
def test_a_target_is_on_this_machine(url, why):
    with pytest.raises(BadTarget, match=why):
        resolve(url)


def test_another_machine_needs_permission():
    assert resolve("http://192.0.2.1:81/path", allow_remote=True)[:3] == ("192.0.2.1", 81, "192.0.2.1:81")


@pytest.mark.parametrize("addresses", [["::1", "127.0.0.1"], ["127.0.0.1", "::1"], ["127.0.0.1"]])
def test_a_name_is_its_ipv4_address_first(monkeypatch, addresses):
    """A server that is told nothing listens there, and `localhost` may name ::1 before."""
    families = {"::1": socket.AF_INET6, "127.0.0.1": socket.AF_INET}
    found = [(families[one], socket.SOCK_STREAM, 6, "", (one, 8000)) for one in addresses]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    assert resolve("http://localhost:8000")[:3] == ("127.0.0.1", 8000, "localhost:8000")
