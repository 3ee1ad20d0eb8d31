"""What a connection may do, tried by clients that do more: over real sockets, with deadlines that are short."""

import json
import time
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from chunkserver.server.problems import PROBLEMS
from tests.fault.sockets import (
    SECONDS_MAX,
    WAITING,
    connected_to,
    connection_to,
    last_words,
    parsed,
    read_answer,
    rest_of,
    says_within,
    sockets_of,
)
from tests.serving import serving, until

LIMITS: dict[str, Any] = {
    "header_seconds": 0.4,
    "keep_alive_seconds": 0.4,
    "send_seconds": 0.4,
    "linger_seconds": 0.4,
    "url_bytes_max": 1000,
    "head_bytes_max": 20_000,
    "head_fields_max": 20,
    "body_bytes_max": 100_000,
    "pipelined_max": 64,
}
LIVE = b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n"
CHUNK = b"GET /v1/seeds/1/chunks/0/0/0/0 HTTP/1.1\r\nHost: x\r\n"
POST = b"POST /v1/recipes HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
CHUNKED = b"Transfer-Encoding: chunked\r\n\r\n"
MANY = 300 << 20
"""Bytes that no server takes from a client that it has answered."""
KERNEL_BYTES_MAX = 32 << 20
"""What the operating system takes of them before it notices."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limits")
    with serving(folder / "log", str(folder / "never"), "1", json.dumps(LIMITS), program=WAITING) as running:
        yield running


def get(path=b"/livez", fields=b""):
    return b"GET " + path + b" HTTP/1.1\r\nHost: x\r\n" + fields + b"\r\n"


REFUSED = {
    "no HTTP": (b"hello\r\n\r\n", "malformed-http"),
    "TLS": (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", "malformed-http"),
    "HTTP/2": (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", "malformed-http"),
    "no path": (b"CONNECT x:80 HTTP/1.1\r\nHost: x\r\n\r\n", "malformed-http"),
    "a path that is not ASCII": (get("/ü".encode()), "malformed-http"),
    "two lengths": (POST + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\n1", "malformed-http"),
    "a length and chunks": (POST + b"Content-Length: 3\r\n" + CHUNKED + b"0\r\n\r\n", "malformed-http"),
    "a length that is no number": (POST + b"Content-Length: ten\r\n\r\n", "malformed-http"),
    "a chunk without a size": (POST + CHUNKED + b"size\r\n", "malformed-http"),
    "a chunk in the body of a GET": (CHUNK + CHUNKED + b"size\r\n", "malformed-http"),
    "a space in a field's name": (get(fields=b"a b: c\r\n"), "malformed-http"),
    "a long URL": (get(b"/" + b"a" * 1000), "url-too-long"),
    "a URL without an end": (b"GET /" + b"a" * 40_000, "url-too-long"),
    "many fields": (get(fields=b"a: b\r\n" * 20), "head-too-large"),
    "a long field": (get(fields=b"a: " + b"b" * 20_000 + b"\r\n"), "head-too-large"),
    "a field without an end": (b"GET / HTTP/1.1\r\na: " + b"b" * 40_000, "head-too-large"),
    "fields without an end": (b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 8000, "head-too-large"),
    "blank lines": (b"\r\n" * 20_000, "head-too-large"),
    "trailers without an end": (CHUNK + CHUNKED + b"0\r\na: " + b"b" * 120_000, "body-too-large"),
    "a chunk's size without an end": (CHUNK + CHUNKED + b"1;" + b"b" * 120_000, "body-too-large"),
    "half a head": (b"GET / HTTP/1.1\r\nHost", "head-too-slow"),
    "half a method": (b"G", "head-too-slow"),
    "half a second head": (LIVE + b"GET /", "head-too-slow"),
}


@pytest.mark.parametrize(("sent", "name"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_is_a_problem_and_the_end(server, sent, name):
    answer = last_words(server, sent)
    if sent.startswith(LIVE):
        assert answer.status == 200
        answer = parsed(answer.behind)
    row = next(row for row in PROBLEMS.values() if row.name == name)
    assert (answer.status, answer.problem, answer.behind) == (row.status, name, b"")
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["connection"] == "close"
    assert answer.headers["cache-control"] == "no-store"
    assert "date" in answer.headers


def test_a_head_that_comes_byte_by_byte_is_too_slow_all_the_same(server):
    began = time.monotonic()
    with connection_to(server) as connection:
        for byte in get(fields=b"a: b\r\n" * 1000):
            connection.sendall(bytes([byte]))
            if says_within(connection, 0.01):
                break
        answer = parsed(rest_of(connection))
    assert answer.problem == "head-too-slow"
    assert time.monotonic() - began >= LIMITS["header_seconds"]


@pytest.mark.parametrize("said", [b"", b"\r\n", LIVE, LIVE + b"\r\n"], ids=["nothing", "a line", "one request", "both"])
def test_a_connection_without_a_request_is_closed(server, said):
    began = time.monotonic()
    with connection_to(server, said) as connection:
        received = rest_of(connection)
    assert time.monotonic() - began >= LIMITS["header_seconds"]
    assert received == b"" if LIVE not in said else parsed(received)[0::3] == (200, b"")


def test_a_connection_in_use_is_not_closed(server):
    with connection_to(server) as connection:
        until_then = time.monotonic() + 3 * LIMITS["keep_alive_seconds"]
        while time.monotonic() < until_then:
            connection.sendall(LIVE)
            assert read_answer(connection).status == 200
            assert not says_within(connection, 0.05)


def test_a_request_that_is_being_answered_is_not_closed(server):
    with connection_to(server, CHUNK + b"\r\n") as connection:
        assert not says_within(connection, 4 * LIMITS["keep_alive_seconds"])


def send_for_ever(connection, piece):
    """Send until the server ends it; return how many bytes it took."""
    taken = 0
    try:
        while taken < MANY:
            connection.sendall(piece)
            taken += len(piece)
    except OSError:
        pass
    return taken


BODIES = {
    "of a length": (b"Content-Length: 400000000\r\n\r\n", bytes(1 << 16)),
    "without an end": (CHUNKED, b"10000\r\n" + bytes(1 << 16) + b"\r\n"),
}


@pytest.mark.parametrize(("fields", "piece"), BODIES.values(), ids=BODIES)
def test_a_body_that_nobody_wants_is_not_read_for_ever(server, fields, piece):
    with connection_to(server, LIVE[:-2] + fields) as connection:
        assert read_answer(connection).status == 200
        assert send_for_ever(connection, piece) < KERNEL_BYTES_MAX


@pytest.mark.parametrize("head", [POST, CHUNK], ids=["POST", "a GET that waits"])
@pytest.mark.parametrize(("fields", "piece"), BODIES.values(), ids=BODIES)
def test_a_body_over_the_limit_is_refused(server, head, fields, piece):
    with connection_to(server, head + fields + piece + piece) as connection:
        answer = read_answer(connection)
        assert (answer.status, answer.problem) == (413, "body-too-large")
        assert send_for_ever(connection, piece) < KERNEL_BYTES_MAX


def test_a_body_that_stops_is_too_slow(server):
    answer = last_words(server, POST + b"Content-Length: 10\r\n\r\n123")
    assert (answer.status, answer.problem) == (408, "body-too-slow")


def test_a_client_that_leaves_inside_of_its_body_is_no_news(server):
    with connection_to(server, POST + b"Content-Length: 10\r\n\r\n123"):
        pass  # the server's log is read at the end


def test_what_stands_behind_a_body_is_the_next_request(server):
    answer = last_words(server, POST + b"Content-Length: 1\r\n\r\nxyz")
    assert (answer.status, answer.headers["connection"], answer.behind) == (422, "close", b"")


def test_a_client_that_asks_first_need_not_send_a_body_that_is_too_long(server):
    expects = POST + b"Expect: 100-continue\r\n"
    with connection_to(server, expects + b"Content-Length: 1000000\r\n\r\n") as connection:
        assert read_answer(connection).status == 413
    with connection_to(server, expects + b"Content-Length: 3\r\n\r\n") as connection:
        assert read_answer(connection).status == 100
        connection.sendall(b"xyz")
        assert read_answer(connection).status == 422


def test_requests_of_one_packet_are_answered_up_to_the_limit(server):
    received = last_words(server, LIVE * 200)
    statuses = []
    while True:
        statuses.append(received.status)
        if not received.behind:
            break
        received = parsed(received.behind)
    assert statuses == [200] * (1 + LIMITS["pipelined_max"])
    assert received.headers["connection"] == "close"


def test_a_client_that_does_not_read_is_given_up(server):
    before = until(lambda: sockets_of(server) < 20 and sockets_of(server), SECONDS_MAX)
    with connection_to(server, get(b"/openapi.json") * (1 + LIMITS["pipelined_max"])):
        until(lambda: sockets_of(server) > before, SECONDS_MAX, "it is connected")
        until(lambda: sockets_of(server) <= before, SECONDS_MAX, "it is given up")


@pytest.mark.parametrize("body", ["[" * 60_000, '{"id":"a","seed":1,"recipe":' + "[" * 60_000, '{"a":' * 10_000])
def test_deep_json_is_refused_at_once(server, body):
    began = time.monotonic()
    request = (
        f"POST /v1/worlds HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    with connection_to(server, request.encode() + body.encode()) as connection:
        answer = read_answer(connection)
    assert (answer.status, answer.problem) == (422, "bad-parameter")
    assert time.monotonic() - began < 1


def test_connections_beyond_the_cap(tmp_path):
    limits = {"connections_max": 8, "linger_seconds": 0.4}
    released = tmp_path / "released"
    with serving(tmp_path / "log", str(released), "1", json.dumps(limits), program=WAITING) as server:
        with several(server) as waiting:
            until(lambda: answered(server), SECONDS_MAX, "one that has waited long gives way")
            assert any(says_within(connection, 0) for connection in waiting)
        with several(server) as busy:
            for connection in busy:
                connection.sendall(CHUNK + b"\r\n")
            refused = until(lambda: refusal(server), SECONDS_MAX, "all are busy")
            assert (refused.status, refused.problem, refused.headers["retry-after"]) == (
                503,
                "too-many-connections",
                "1",
            )
            released.touch()
            assert {read_answer(connection).body for connection in busy} == {b"built"}
        until(lambda: answered(server), SECONDS_MAX, "there is room again")


@contextmanager
def several(server):
    with ExitStack() as connections:
        yield [connections.enter_context(connected_to(server)) for _ in range(8)]


def answered(server):
    with connection_to(server, LIVE) as connection:
        return read_answer(connection).status == 200


def refusal(server):
    with connection_to(server) as connection:
        answer = parsed(rest_of(connection)) if says_within(connection, 0.5) else None
        return answer if answer and answer.status == 503 else None
