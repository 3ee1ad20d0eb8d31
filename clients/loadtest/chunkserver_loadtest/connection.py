"""One connection of HTTP/1.1: one request at a time, little work for each. httptools reads the answers."""

import asyncio
import time
from collections.abc import Callable
from typing import Final, cast

import httptools

from chunkserver_loadtest.exchange import Answer, Exchange, Request

ANSWER_BYTES_MAX: Final = 1 << 28
"""The largest batch that there can be: 1,024 chunks of 256 KB."""
HEAD_BYTES_MAX: Final = 1 << 16
DETAIL_CHARACTERS_MAX: Final = 200
"""Of what a failure quotes."""

Told = Callable[["Connection"], None]
HEAD_END: Final = b"\r\n\r\n"
NOTHING: Final = Exchange(Request("/"), 0.0)
"""The exchange of a connection that has not been asked yet."""


class Connection(asyncio.Protocol):
    """Sends a request, reads its answer, and says that it is free again; or that it is lost.

    free: called after each answer. lost: called once, when no more requests can be sent. `exchange` is the last one:
    of a lost connection, its `failure` says whether the answer is missing.
    """

    def __init__(self, fixed: bytes, free: Told, lost: Told) -> None:
        self.exchange = NOTHING
        self._fixed = fixed
        self._free = free
        self._lost = lost
        self._closed = False
        self._complete = True
        self._stays = True
        self._noted = 0
        self._head = b""
        self._head_ended = False
        self._pieces: list[bytes] = []
        self.on_body = self._pieces.append  # called by httptools, without Python in between
        self._parser = httptools.HttpResponseParser(self)

    def ask(self, exchange: Exchange) -> None:
        """Send a request."""
        self.exchange = exchange
        self._complete = False
        self._noted = 0
        self._head = b""
        self._head_ended = False
        self._pieces.clear()
        exchange.sent = time.perf_counter()
        self._transport.write(exchange.request.wire(self._fixed))

    def fail(self, failure: str, detail: str = "") -> None:
        """End the exchange, and with it the connection, of which nobody can say what would come next."""
        if self._closed:
            return
        self._closed = True
        if not self._complete:
            self.exchange.ended = time.perf_counter()
            self.exchange.failure, self.exchange.detail = failure, detail[:DETAIL_CHARACTERS_MAX]
        self._transport.abort()
        self._lost(self)

    def close(self) -> None:
        """End it; nobody is told."""
        self._closed = True
        self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its bases

    def data_received(self, data: bytes) -> None:
        self.exchange.received += len(data)
        if self._complete:  # nothing was asked: it belongs to the answer before
            self.exchange = Exchange(self.exchange.request, time.perf_counter(), time.perf_counter())
            self._complete = False
            self.fail("extra-bytes", f"{data[:40]!r}")
            return
        if not self._head_ended:
            self._head += data
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError as error:
            failure = "extra-bytes" if self._complete else "malformed-http"
            self._complete = False
            self.fail(failure, f"{error}: {data[:40]!r}")
            return
        self._read_on()

    def _read_on(self) -> None:
        """Go on after what has just been read: it is too much, or all, or a part."""
        most = ANSWER_BYTES_MAX if self._head_ended else HEAD_BYTES_MAX
        if self.exchange.received > most:
            self._complete = False
            self.fail("too-large", f"more than {most} bytes")
        elif self._complete:
            self._answered()
        elif self.exchange.request.body:
            self._note_arrival(time.perf_counter())

    def connection_lost(self, error: Exception | None) -> None:
        received = self.exchange.received
        self.fail("cut" if received else "closed", f"{received} bytes had come. {error or ''}".strip())

    def on_message_begin(self) -> None:
        """Refuse a second answer: httptools calls this."""
        if self._complete:
            raise ValueError("one answer follows another")

    def on_headers_complete(self) -> None:
        """Note that the head is there: httptools calls this. Header fields are read when somebody asks for them."""
        self._head_ended = True
        self._head = self._head[: self._head.index(HEAD_END)]

    def on_message_complete(self) -> None:
        """Note that all of the answer is there: httptools calls this, and knows now whether the connection stays."""
        self._complete = True
        self._stays = self._parser.should_keep_alive()

    def _answered(self) -> None:
        exchange = self.exchange
        exchange.ended = time.perf_counter()
        exchange.answer = Answer(self._parser.get_status_code(), self._head, tuple(self._pieces))
        if exchange.request.body:
            self._note_arrival(exchange.ended)
        if self._stays:
            self._free(self)
        else:
            self._closed = True
            self._transport.close()
            self._lost(self)

    def _note_arrival(self, moment: float) -> None:
        """Write down how much of a batch's body has come."""
        arrivals, fresh = self.exchange.arrivals, self._pieces[self._noted :]
        arrivals.append(((arrivals[-1][0] if arrivals else 0) + sum(map(len, fresh)), moment))
        self._noted = len(self._pieces)
