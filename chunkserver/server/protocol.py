"""One connection: uvicorn's HTTP protocol, bounded. What it refuses, it refuses with a problem, and closes.

uvicorn parses, calls the application and writes the answer. It bounds neither how long a head takes, nor how large it
is, nor how much is sent to an application that does not read; nor how long it waits for a client that does not read.
The tests of this module fail if the parts of uvicorn that are relied on here change.
"""

import asyncio
import json
import math
from enum import Enum
from functools import partial
from typing import Any, Final, NoReturn, cast

from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import ServerState

from chunkserver.errors import ChunkError
from chunkserver.server.connections import ConnectionLimits, Connections, Watched
from chunkserver.server.problems import (
    MEDIA_TYPE,
    PROBLEMS,
    BodyTooLarge,
    HeadTooLarge,
    HeadTooSlow,
    MalformedHttp,
    TooManyConnections,
    UrlTooLong,
    problem_body,
)

PIECE_BYTES: Final = 8 << 10
"""What is parsed at once. Between two pieces the limits on bytes are looked at."""
WITHOUT_BODY: Final = frozenset({"GET", "HEAD", "OPTIONS", "DELETE"})
"""Methods whose requests are answered without waiting for a body."""


class Part(Enum):
    """What of a request is arriving."""

    NONE = "between two requests"
    HEAD = "its head"
    BODY = "its body"


class Wait(Enum):
    """What a connection waits for, and by what name it is counted when it waits too long."""

    FIRST = "silent"
    HEAD = "head-too-slow"
    NEXT = "idle"
    ANSWER = "answer"
    READER = "not-reading"
    CLOSE = "lingering"


FOR_A_REQUEST: Final = frozenset({Wait.FIRST, Wait.HEAD, Wait.NEXT})
GAVE_WAY: Final = "gave-way"

_State = tuple[Wait, object, int]


class Refused(Exception):
    """Ends the parser from inside of one of its callbacks."""


class Bounds:
    """What all connections of a server share: `connections`, and what their limits come to."""

    def __init__(self, connections: Connections) -> None:
        self.connections = connections
        self.limits = limits = connections.limits
        seconds = {
            Wait.FIRST: limits.header_seconds,
            Wait.HEAD: limits.header_seconds,
            Wait.NEXT: limits.keep_alive_seconds,
            Wait.ANSWER: math.inf,
            Wait.READER: limits.send_seconds,
            Wait.CLOSE: limits.linger_seconds,
        }
        self.looks_max = {wait: connections.looks_in(limit) for wait, limit in seconds.items()}
        self.answers = {kind: _answer(kind, *account) for kind, account in _accounts(limits).items()}


class BoundedProtocol(HttpToolsProtocol, Watched):
    """One connection. uvicorn makes one for each that it accepts."""

    # Slots, for speed: with a few attributes more, the instance's dictionary shares its keys with no other any more.
    # Then each access to any attribute is slower, uvicorn's own too: 7 us a request.
    __slots__ = (
        "_answering",
        "_begun",
        "_bounds",
        "_ended",
        "_fault",
        "_limits",
        "_looks",
        "_part_bytes",
        "_parting",
        "_pauses",
        "_state_seen",
    )

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        bounds: Bounds,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._bounds = bounds
        self._limits = bounds.limits
        self._answering: RequestResponseCycle | None = None  # the request whose turn it is, if it had to wait for it
        self._begun: object = None  # the scope of the head that `_part_bytes` are of
        self._part_bytes = 0  # that arrived before the piece that is being parsed
        self._fault: type[ChunkError] = MalformedHttp  # what the parser fails for
        self._ended = False  # nothing that arrives is looked at any more
        self._parting = False  # and nothing is left to be sent
        self._pauses = 0
        self._state_seen: _State = (Wait.ANSWER, None, 0)
        self._looks = 0

    # What uvicorn, or the event loop, calls

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Be admitted, or refused."""
        super().connection_made(transport)
        if self._bounds.connections.admit(self.connections):
            return
        self.connections.discard(self)
        self._refuse(TooManyConnections)
        if not self._bounds.connections.see_off(self):
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Be forgotten."""
        answering = self._answering
        if answering is not None and not answering.response_complete:
            answering.disconnected = True  # uvicorn tells only the last of several requests
            answering.message_event.set()
        super().connection_lost(exc)
        self._bounds.connections.forget(self)

    def data_received(self, data: bytes) -> None:
        """Parse what has arrived, in pieces."""
        if len(data) <= PIECE_BYTES:
            self._parse(data)
        else:
            for start in range(0, len(data), PIECE_BYTES):
                self._parse(data[start : start + PIECE_BYTES])

    def send_400_response(self, _msg: str) -> None:
        """uvicorn says that the parser has failed: by itself, or because a callback refused."""
        self._refuse(self._fault)

    def on_headers_complete(self) -> None:
        """A head is complete: refuse it, or have it answered."""
        limits = self._limits
        if len(self.url) > limits.url_bytes_max:
            self._fail(UrlTooLong)
        if len(self.headers) > limits.head_fields_max:
            self._fail(HeadTooLarge)
        if self._part_bytes + PIECE_BYTES > limits.head_bytes_max and self._head_bytes() > limits.head_bytes_max:
            self._fail(HeadTooLarge)
        if len(self.pipeline) >= limits.pipelined_max:
            self._fail(MalformedHttp)  # which nobody will read: there are answers to come before
        self._part_bytes = 0
        HttpToolsProtocol.on_headers_complete(self)
        if self.scope["method"] not in WITHOUT_BODY:
            self.cycle.transport = _ClosedLast(self)  # type: ignore[assignment]

    def on_response_complete(self) -> None:
        """An answer is written. uvicorn would set a timer for the next request; here the next look starts that wait."""
        if self.pipeline:
            self._answering = self.pipeline[-1][0]
        if self.pipeline or self.flow.read_paused:
            super().on_response_complete()

    def pause_writing(self) -> None:
        """The client does not read as fast as it is sent to."""
        self._pauses += 1
        super().pause_writing()

    def handle_websocket_upgrade(self) -> None:
        """A WebSocket is asked for: another protocol takes over."""
        if self.cycle is not None and not self.cycle.response_complete:
            self._refuse(MalformedHttp)  # another answer is still to come
            return
        self._ended = True
        super().handle_websocket_upgrade()

    def _should_upgrade(self) -> bool:
        return self.scope["method"] == "GET" and super()._should_upgrade()

    # What `Connections` calls

    def look(self) -> int:
        """See `Watched`."""
        state = self._state()
        self._looks = self._looks + 1 if state == self._state_seen else 0
        self._state_seen = state
        wait = state[0]
        if self._looks >= self._bounds.looks_max[wait]:
            self._end(wait)
        return self._looks if wait in FOR_A_REQUEST else 0

    def give_way(self) -> bool:
        """See `Watched`."""
        if self._state() != self._state_seen or self._state_seen[0] not in FOR_A_REQUEST:
            return False
        self._bounds.connections.count(GAVE_WAY)
        self.transport.abort()
        return True

    def part(self) -> None:
        """Close the connection, but not before its client has stopped sending: else it may lose the answer.

        To close with bytes unread resets the connection, and the client's system throws away what it has not read yet.
        """
        if self._part() is Part.NONE or self.transport.is_closing():
            self.transport.close()
        else:
            self._linger()

    # Inside

    def _parse(self, piece: bytes) -> None:
        if not self._ended:
            HttpToolsProtocol.data_received(self, piece)
            cycle = self.cycle
            if cycle is not None and cycle.scope is self.scope and not cycle.more_body:
                return  # nothing but whole requests
        self._count(len(piece))

    def _count(self, size: int) -> None:
        """Bound what comes without completing a request."""
        limits = self._limits
        part = self._part()
        if part is Part.HEAD and self._begun is not self.scope:
            self._begun = self.scope
            self._part_bytes = 0
        self._part_bytes += size
        if self._ended:
            if self._part_bytes > limits.body_bytes_max:
                self.transport.abort()
        elif part is Part.BODY:
            if self._part_bytes > limits.body_bytes_max:
                self._refuse(BodyTooLarge)
        elif self._part_bytes > limits.head_bytes_max + PIECE_BYTES:  # the first piece may hold other things too
            self._refuse(UrlTooLong if part is Part.HEAD and len(self.url) > limits.url_bytes_max else HeadTooLarge)

    def _part(self) -> Part:
        cycle, scope = self.cycle, self.scope
        if scope is not None and (cycle is None or cycle.scope is not scope):
            return Part.HEAD
        return Part.BODY if cycle is not None and cycle.more_body else Part.NONE

    def _head_bytes(self) -> int:
        return len(self.url) + sum(len(name) + len(value) for name, value in self.headers)

    def _fail(self, fault: type[ChunkError]) -> NoReturn:
        self._fault = fault
        raise Refused

    def _refuse(self, kind: type[ChunkError]) -> None:
        """Answer for the last time; but if earlier requests are still to be answered, only close after them."""
        self._bounds.connections.count(PROBLEMS[kind].name)
        self._ended = True
        cycle = self.cycle
        if cycle is None or cycle.response_complete:
            self._answer_last(kind)
        elif self._part() is not Part.BODY:
            cycle.keep_alive = False
        elif self.pipeline or cycle.response_started:
            self.transport.abort()  # the fault is in a body whose answer has its turn later, or has begun
        else:
            cycle.disconnected = True  # the application is told that nobody is there any more
            cycle.message_event.set()
            self._answer_last(kind)

    def _answer_last(self, kind: type[ChunkError]) -> None:
        status, fields = self._bounds.answers[kind]
        date = b"".join(b"%s: %s\r\n" % field for field in self.server_state.default_headers)
        self.transport.write(status + date + fields)
        self._linger()

    def _linger(self) -> None:
        self._ended = self._parting = True
        self._part_bytes = 0
        self.pipeline.clear()
        self.transport.write_eof()

    def _state(self) -> _State:
        cycle = self.cycle
        closes = self._parting or self.transport.is_closing()
        if self.flow.write_paused or (closes and self.transport.get_write_buffer_size()):
            return (Wait.READER, None, self._pauses)
        if closes:
            return (Wait.CLOSE, None, 0)
        if cycle is not None and not cycle.response_complete:
            return (Wait.ANSWER, cycle, 0)
        if self._part() is Part.HEAD:
            return (Wait.HEAD, cycle, 0)
        return (Wait.FIRST if cycle is None else Wait.NEXT, cycle, 0)

    def _end(self, wait: Wait) -> None:
        if wait is Wait.HEAD:
            self._refuse(HeadTooSlow)
            return
        self._bounds.connections.count(wait.value)
        if wait in FOR_A_REQUEST:
            self.transport.close()
        else:
            self.transport.abort()


class _ClosedLast:
    """What the answer to a request with a body is written to: closes by `BoundedProtocol.part`."""

    __slots__ = ("close", "is_closing", "write")

    def __init__(self, connection: BoundedProtocol) -> None:
        self.close = connection.part
        self.is_closing = connection.transport.is_closing
        self.write = connection.transport.write


def bounded(connections: Connections) -> type[asyncio.Protocol]:
    """Return what uvicorn takes for its `http`: it makes the protocol of each connection."""
    return cast(type[asyncio.Protocol], partial(BoundedProtocol, bounds=Bounds(connections)))


def _accounts(limits: ConnectionLimits) -> dict[type[ChunkError], tuple[str, dict[str, object]]]:
    """What to tell about each refusal: a sentence, and the limit."""
    return {
        MalformedHttp: ("what came over this connection cannot be read as HTTP/1.1", {}),
        HeadTooSlow: (
            f"the head of the request was not there after {limits.header_seconds:g} s",
            {"seconds_max": limits.header_seconds},
        ),
        UrlTooLong: (f"the URL is longer than {limits.url_bytes_max} bytes", {"bytes_max": limits.url_bytes_max}),
        HeadTooLarge: (
            f"the limits are {limits.head_bytes_max} bytes and {limits.head_fields_max} header fields",
            {"bytes_max": limits.head_bytes_max, "fields_max": limits.head_fields_max},
        ),
        BodyTooLarge: (
            f"the body is longer than {limits.body_bytes_max} bytes",
            {"bytes_max": limits.body_bytes_max},
        ),
        TooManyConnections: (
            f"{limits.connections_max} connections are open, and all of them are busy",
            {"connections_max": limits.connections_max},
        ),
    }


def _answer(kind: type[ChunkError], detail: str, values: dict[str, object]) -> tuple[bytes, bytes]:
    """Return an answer as bytes: its first line, and all that stands behind the headers of every answer."""
    problem = PROBLEMS[kind]
    body = json.dumps(problem_body(problem, detail, values)).encode()
    fields = {
        "content-type": MEDIA_TYPE,
        "content-length": str(len(body)),
        "cache-control": "no-store",
        "connection": "close",
    }
    if problem.retry_after is not None:
        fields["retry-after"] = str(problem.retry_after)
    head = "".join(f"{name}: {value}\r\n" for name, value in fields.items())
    return STATUS_LINE[problem.status], f"{head}\r\n".encode() + body
