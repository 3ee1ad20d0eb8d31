"""The client that makes the load, against small servers that answer as we tell them to."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from benchmarks import load
from benchmarks.load import Load, Request, offer, send

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\nETag: x\r\n\r\nhello"
NOT_MODIFIED = b"HTTP/1.1 304 Not Modified\r\nContent-Length: 5\r\n\r\n"


@pytest.fixture(autouse=True)
def _short_load(monkeypatch):
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 5.0)


@contextmanager
def answering(*pieces: bytes, answers: int = 1000) -> Iterator[tuple[str, list[bytes]]]:
    """Yield the URL of a server that answers each request with `pieces`, and the requests that it got.

    Each connection is closed when it has had so many answers.
    """
    requests: list[bytes] = []
    listening = socket.create_server(("127.0.0.1", 0))

    def serve_one(connection: socket.socket) -> None:
        with connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for _ in range(answers):
                request = connection.recv(1 << 16)
                if not request:
                    return
                requests.append(request)
                for piece in pieces:
                    connection.sendall(piece)

    def accept() -> None:
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            thread = threading.Thread(target=serve_one, args=(connection,))
            thread.start()
            threads.append(thread)

    threads = [threading.Thread(target=accept)]
    threads[0].start()
    try:
        host, port = listening.getsockname()
        yield f"http://{host}:{port}", requests
    finally:
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        for thread in threads:
            thread.join()


def requests_for(*paths: str) -> list[Request]:
    return [Request(path) for path in paths]


def test_every_request_is_sent_once_over_all_connections():
    paths = [f"/{number}" for number in range(50)]
    with answering(OK) as (url, requests):
        done = send(url, requests_for(*paths), connections=4)
    assert sorted(request.split()[1].decode() for request in requests) == sorted(paths)
    assert (done.answers, done.bytes, dict(done.statuses)) == (50, 50 * len(OK), {"200": 50})
    assert done.latencies == sorted(done.latencies)
    assert done.seconds > 0


@pytest.mark.parametrize("cut", [1, 20, len(OK) - 8, len(OK) - 1])
def test_an_answer_may_come_in_pieces(cut):
    with answering(OK[:cut], OK[cut:]) as (url, _):
        done = send(url, requests_for("/a", "/b"), connections=1)
    assert (done.answers, done.bytes) == (2, 2 * len(OK))


def test_a_304_has_no_body_whatever_its_length_says():
    with answering(NOT_MODIFIED) as (url, requests):
        done = send(url, [Request("/a", '"tag"')] * 2, connections=1)
    assert dict(done.statuses) == {"304": 2}
    assert all(b'\r\nIf-None-Match: "tag"\r\n' in request for request in requests)


def test_a_connection_that_ends_early_is_an_error():
    with answering(OK, answers=1) as (url, _), pytest.raises(ConnectionError):
        send(url, requests_for("/a", "/b"), connections=1)


def test_an_answer_without_a_length_is_an_error():
    with answering(b"HTTP/1.1 200 OK\r\n\r\n") as (url, _), pytest.raises(ValueError, match="no Content-Length"):
        send(url, requests_for("/a"), connections=1)


def test_a_silent_server_is_an_error(monkeypatch):
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 0.1)
    with answering() as (url, _), pytest.raises(TimeoutError):
        send(url, requests_for("/a"), connections=2)


def test_quantiles_are_of_the_sorted_latencies():
    done = Load(latencies=[1.0, 2.0, 3.0, 4.0])
    assert [done.quantile(share) for share in (0, 0.5, 0.99, 1)] == [1.0, 3.0, 4.0, 4.0]


def test_an_open_loop_sends_as_many_as_are_due_and_counts_every_answer():
    with answering(OK) as (url, requests):
        done = offer(url, (Request(f"/{number}") for number in range(1000)), rate=200.0, seconds=0.5)
    assert (done.answers, dict(done.statuses), len(requests)) == (100, {"200": 100}, 100)
    assert len({request.split()[1] for request in requests}) == 100
    assert done.seconds >= 0.49
    assert sorted(done.good_latencies) == done.latencies


def test_an_open_loop_goes_on_when_a_connection_ends_before_its_answer():
    with answering(OK, answers=1) as (url, _):
        done = offer(url, (Request("/") for _ in range(1000)), rate=100.0, seconds=0.3)
    assert done.answers + done.statuses["end"] == 30
    assert done.statuses["200"] == done.answers > 0


def test_an_open_loop_does_not_open_connections_for_ever(monkeypatch):
    monkeypatch.setattr(load, "OPEN_CONNECTIONS_MAX", 4)
    monkeypatch.setattr(load, "LOAD_SECONDS_MAX", 1.0)
    with answering(b"HTTP/1.1 200 OK\r\n") as (url, requests), pytest.raises(TimeoutError):
        offer(url, (Request("/") for _ in range(1000)), rate=100.0, seconds=0.5)
    assert len(requests) == 4
