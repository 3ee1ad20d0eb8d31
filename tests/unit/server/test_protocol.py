"""One connection without a socket: exact limits, however its bytes are cut; and what is relied on of uvicorn."""

import asyncio
import json
from collections import Counter
from typing import Any

import pytest
import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from chunkserver.server import connections as connections_module
from chunkserver.server.connections import ConnectionLimits, Connections
from chunkserver.server.protocol import PIECE_BYTES, bounded

LIMITS = ConnectionLimits(
    connections_max=3,
    header_seconds=4.0,
    keep_alive_seconds=6.0,
    send_seconds=8.0,
    linger_seconds=4.0,
    url_bytes_max=100,
    head_bytes_max=200,
    head_fields_max=5,
    body_bytes_max=100_000,
    pipelined_max=3,
)
GET = b"GET / HTTP/1.1\r\n\r\n"


class Transport(asyncio.Transport):
    """Holds what is written, and what was done to it."""

    def __init__(self):
        super().__init__()
        self.written = b""
        self.done: list[str] = []
        self.unread = 0

    def get_extra_info(self, _name, default=None):
        return default

    def write(self, data):
        self.written += data

    def write_eof(self):
        self.done.append("eof")

    def close(self):
        self.done.append("close")

    def abort(self):
        self.done.append("abort")

    def is_closing(self):
        return "close" in self.done or "abort" in self.done

    def get_write_buffer_size(self):
        return self.unread

    def pause_reading(self): ...

    def resume_reading(self): ...


class Server:
    """An application that answers when `go` is set, and connections to it."""

    def __init__(self, limits=LIMITS):
        self.connections = Connections(limits)
        self.state = ServerState()
        self.config = uvicorn.Config(
            self.app, interface="asgi3", proxy_headers=False, access_log=False, log_config=None, ws="none"
        )
        self.config.load()
        self.make: Any = bounded(self.connections)
        self.go = asyncio.Event()
        self.go.set()
        self.left = 0

    async def app(self, _scope, receive, send):
        await self.go.wait()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"ok"})
        self.left += (await receive())["type"] == "http.disconnect"

    def connect(self, *pieces, make=None):
        protocol, transport = (make or self.make)(self.config, self.state, {}), Transport()
        protocol.connection_made(transport)
        for piece in pieces:
            protocol.data_received(piece)
        return protocol, transport


def scenario(play):
    """Run a coroutine function of a test with a `Server`, which it may replace."""

    async def played():
        await play(Server())

    return lambda: asyncio.run(asyncio.wait_for(played(), 10))


async def settle():
    for _ in range(20):
        await asyncio.sleep(0)


def problem_of(transport):
    return json.loads(transport.written.rpartition(b"\r\n\r\n")[2])["type"].rpartition(":")[2]


def cut(request, size):
    return [request[start : start + size] for start in range(0, len(request), size)]


def head(url_bytes=1, fields=1, bytes_of_all=None):
    """A head of exactly these sizes; each field but the last has two bytes."""
    last = max(0, (bytes_of_all or 0) - url_bytes - 2 * fields)
    lines = [b"GET /" + b"u" * (url_bytes - 1) + b" HTTP/1.1", *[b"a:b"] * (fields - 1), b"a:b" + b"b" * last, b"", b""]
    return b"\r\n".join(lines)


@pytest.mark.parametrize("size", [1, 7, 10_000])
@pytest.mark.parametrize(
    ("fits", "over", "name"),
    [
        (head(url_bytes=100), head(url_bytes=101), "url-too-long"),
        (head(fields=5), head(fields=6), "head-too-large"),
        (head(bytes_of_all=200), head(bytes_of_all=201), "head-too-large"),
    ],
    ids=["url", "fields", "bytes"],
)
def test_limits_of_a_head_are_exact(size, fits, over, name):
    @scenario
    async def play(server):
        _, transport = server.connect(*cut(fits, size), *cut(fits, size))
        await settle()
        assert transport.written.count(b"HTTP/1.1 200 OK") == 2
        assert not transport.done
        _, transport = server.connect(*cut(over, size))
        assert problem_of(transport) == name
        assert transport.done == ["eof"]
        assert server.connections.ended == {name: 1}

    play()


def test_a_head_behind_a_body_in_one_packet_does_not_count_the_body():
    @scenario
    async def play(server):
        post = b"POST / HTTP/1.1\r\nContent-Length: 20000\r\n\r\n" + bytes(20_000)
        _, transport = server.connect(post + head(bytes_of_all=200)[:-1])
        await settle()
        assert transport.written.count(b"HTTP/1.1 200 OK") == 1
        assert "eof" not in transport.done

    play()


def test_a_head_without_an_end_is_held_up_to_its_limit_and_two_pieces():
    @scenario
    async def play(server):
        protocol, transport = server.connect(b"GET / HTTP/1.1\r\na:")
        sent = 0
        while not transport.written:
            protocol.data_received(b"b" * 100)
            sent += 100
        assert sent <= LIMITS.head_bytes_max + 2 * PIECE_BYTES

    play()


def test_what_comes_behind_a_refusal_is_dropped_and_bounded():
    @scenario
    async def play(server):
        protocol, transport = server.connect(b"hello\r\n\r\n")
        written = transport.written
        protocol.data_received(GET)
        await settle()
        assert (transport.written, transport.done) == (written, ["eof"])
        protocol.data_received(bytes(LIMITS.body_bytes_max + 1))
        assert "abort" in transport.done

    play()


def test_requests_before_a_fault_are_answered_and_then_it_is_closed():
    @scenario
    async def play(server):
        server.go.clear()
        _, transport = server.connect(GET * 3 + b"hello\r\n\r\n")
        await settle()
        assert not transport.written
        server.go.set()
        await settle()
        assert transport.written.count(b"HTTP/1.1 200 OK") == 3
        assert transport.written.count(b"connection: close") == 1
        assert transport.done[-1] == "close"

    play()


def test_the_application_is_told_when_its_request_is_refused():
    @scenario
    async def play(server):
        server.go.clear()
        _, transport = server.connect(b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", b"size\r\n")
        assert problem_of(transport) == "malformed-http"
        written = transport.written
        server.go.set()
        await settle()
        assert server.left == 1
        assert transport.written == written

    play()


def test_of_several_requests_the_one_being_answered_learns_that_the_client_left():
    @scenario
    async def play(server):
        protocol, transport = server.connect(GET * 3)
        server.go.clear()
        await settle()
        server.go.set()
        await asyncio.sleep(0)
        server.go.clear()
        await settle()
        answered = transport.written.count(b"HTTP/1.1 200 OK")
        protocol.connection_lost(None)
        server.go.set()
        await settle()
        assert answered < 3
        assert transport.written.count(b"HTTP/1.1 200 OK") == answered

    play()


def looks_until(protocol, transport, act):
    """How many looks it takes until the connection is ended by `act`; 100 if it is not."""
    looks = 0
    while act not in transport.done and looks < 100:
        protocol.look()
        looks += 1
    return looks


@pytest.mark.parametrize(
    ("said", "act", "seconds"),
    [
        (b"", "close", LIMITS.header_seconds),
        (b"\r\n", "close", LIMITS.header_seconds),
        (b"GET", "eof", LIMITS.header_seconds),
        (GET, "close", LIMITS.keep_alive_seconds),
        (GET + b"\r\n", "close", LIMITS.keep_alive_seconds),
        (GET + b"G", "eof", LIMITS.header_seconds),
    ],
)
def test_deadlines_are_counted_in_looks(said, act, seconds):
    @scenario
    async def play(server):
        protocol, transport = server.connect(said)
        await settle()
        assert looks_until(protocol, transport, act) == 1 + seconds / LIMITS.look_seconds
        assert looks_until(protocol, transport, "abort") == 1 + LIMITS.linger_seconds / LIMITS.look_seconds

    play()


def test_no_deadline_while_an_answer_is_made_and_one_while_it_is_not_read():
    @scenario
    async def play(server):
        server.go.clear()
        protocol, transport = server.connect(GET)
        await settle()
        assert looks_until(protocol, transport, "abort") == 100
        for _ in range(20):  # each time it reads a little
            protocol.pause_writing()
            assert protocol.look() == 0
            protocol.resume_writing()
        assert not transport.done
        protocol.pause_writing()
        assert looks_until(protocol, transport, "abort") == 1 + LIMITS.send_seconds / LIMITS.look_seconds
        protocol.resume_writing()
        server.go.set()
        await settle()

    play()


def test_a_closing_connection_may_take_its_time_to_read_the_last_answer():
    @scenario
    async def play(server):
        protocol, transport = server.connect(b"hello\r\n\r\n")
        transport.unread = 1
        assert looks_until(protocol, transport, "abort") == 1 + LIMITS.send_seconds / LIMITS.look_seconds

    play()


def test_a_full_server_closes_who_has_waited_longest_else_refuses():
    @scenario
    async def play(server):
        first, first_transport = server.connect()
        first.look()
        server.connect(GET)
        server.connect()
        await settle()
        server.connections._look()
        server.connections._look()
        first.look()
        server.connections._waiting.sort(key=lambda pair: pair[0])
        _, transport = server.connect(GET)
        assert first_transport.done == ["abort"]
        assert not transport.done
        server.state.connections.discard(first)
        server.connections._waiting.clear()
        _, transport = server.connect(GET)
        assert problem_of(transport) == "too-many-connections"
        assert b"retry-after: 1\r\n" in transport.written
        assert len(server.state.connections) == 3
        assert server.connections.open == 4

    play()


def test_who_has_begun_a_request_since_the_last_look_does_not_give_way():
    @scenario
    async def play(server):
        protocol, transport = server.connect()
        protocol.look()
        protocol.look()
        server.go.clear()
        protocol.data_received(GET)
        assert not protocol.give_way()
        assert not transport.done

    play()


def test_those_who_are_refused_are_held_up_to_a_limit(monkeypatch):
    monkeypatch.setattr(connections_module, "PARTING_MAX", 2)

    @scenario
    async def play(server):
        for _ in range(LIMITS.connections_max):
            server.connect()
        refused = [server.connect() for _ in range(4)]
        assert Counter(tuple(transport.done) for _, transport in refused) == {("eof",): 2, ("eof", "close"): 2}
        refused[0][0].connection_lost(None)
        assert server.connect()[1].done == ["eof"]

    play()


def test_no_timer_is_set_and_no_attribute_is_added_on_the_way_of_a_request():
    @scenario
    async def play(server):
        ours, _ = server.connect(GET)
        plain, _ = server.connect(GET, make=HttpToolsProtocol)
        await settle()
        assert ours.timeout_keep_alive_task is None
        assert plain.timeout_keep_alive_task is not None
        assert vars(ours).keys() == vars(plain).keys()  # see the comment at its slots
        plain.timeout_keep_alive_task.cancel()

    play()


def test_the_parts_of_uvicorn_that_are_relied_on():
    @scenario
    async def play(server):
        server.go.clear()
        plain, _ = server.connect(
            GET + GET + GET + b"POST / HTTP/1.1\r\nContent-Length: 1\r\n\r\n", make=HttpToolsProtocol
        )
        await settle()
        assert plain.cycle.scope is plain.scope
        assert plain.cycle.more_body
        assert [cycle.scope["method"] for cycle, _ in plain.pipeline] == ["POST", "GET", "GET"]  # the right end is next
        for name in (
            "disconnected",
            "keep_alive",
            "message_event",
            "response_complete",
            "response_started",
            "transport",
        ):
            assert hasattr(plain.cycle, name)
        assert not plain.flow.write_paused
        plain.data_received(b"1G")
        assert not plain.cycle.more_body
        assert plain.cycle.scope is not plain.scope  # a head has begun
        for task in server.state.tasks:
            task.cancel()

    play()
