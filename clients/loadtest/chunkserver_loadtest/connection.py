"""One connection of HTTP/1.1: one request at a time, little work for each. httptools reads the answers."""

import asyncio
import time
from collections.abc import Callable
from typing import Final, cast

import httptools

from chunkserver_loadtest.exchange import Answer, Exchange, Request

ANSWER_BYTES_MAX: Final = 1 << 28
"""Of a body: the largest batch that there can be, 1,024 chunks of 256 KB."""
DETAIL_CHARACTERS_MAX: Final = 200
"""Of what a failure quotes."""

Told = Callable[["Connection"], None]
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
        self._parser = httptools.HttpResponseParser(self)
        self._complete = True
        self._begun = False
        self._stays = True
        self._fields: dict[bytes, bytes] = {}
        self._pieces: list[bytes] = []
        self._received = 0

    def ask(self, exchange: Exchange) -> None:
        """Send a request."""
        self.exchange = exchange
        self._complete = False
        self._begun = False
        self._fields = {}
        self._pieces = []
        self._received = 0
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
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError as error:
            failure = "extra-bytes" if self._complete else "malformed-http"
            self._complete = False
            self.fail(failure, f"{error}: {data[:40]!r}")
            return
        self._progressed()

    def _progressed(self) -> None:
        if self._received > ANSWER_BYTES_MAX:
            self._complete = False
            self.fail("too-large", f"more than {ANSWER_BYTES_MAX} bytes")
        elif self._complete:
            self._answered()
        elif self.exchange.request.body:
            self.exchange.arrivals.append((self._received, time.perf_counter()))

    def connection_lost(self, error: Exception | None) -> None:
        detail = f"{self._received} bytes of the body had come. {error or ''}"
        self.fail("cut" if self._begun else "closed", detail.strip())

    def on_message_begin(self) -> None:
        """Refuse a second answer: httptools calls this."""
        if self._complete:
            raise ValueError("one answer follows another")
        self._begun = True

    def on_header(self, name: bytes, value: bytes) -> None:
        """Keep a header field: httptools calls this."""
        self._fields[name.lower()] = value

    def on_body(self, piece: bytes) -> None:
        """Keep a piece of the body: httptools calls this."""
        self._pieces.append(piece)
        self._received += len(piece)

    def on_message_complete(self) -> None:
        """Note that all of the answer is there: httptools calls this, and knows now whether the connection stays."""
        self._complete = True
        self._stays = self._parser.should_keep_alive()

    def _answered(self) -> None:
        exchange = self.exchange
        exchange.ended = time.perf_counter()
        exchange.answer = Answer(self._parser.get_status_code(), self._fields, tuple(self._pieces))
        if exchange.request.body:
            exchange.arrivals.append((self._received, exchange.ended))
        if self._stays:
            self._free(self)
        else:
            self._closed = True
            self._transport.close()
            self._lost(self)
