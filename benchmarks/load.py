"""A small HTTP/1.1 client for load: keep-alive connections in a closed loop, as little work per request as we can.

It understands what our server sends and no more: Content-Length bodies, no chunked coding, no redirects.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, cast
from urllib.parse import urlsplit

import uvloop

HEAD_END: Final = b"\r\n\r\n"
LENGTH: Final = b"\r\ncontent-length:"
WITHOUT_BODY: Final = (b"204", b"304")
LOAD_SECONDS_MAX: Final = 300.0


class Request(NamedTuple):
    """What to ask for, and the etag to send as `If-None-Match`, if any."""

    path: str
    etag: str = ""

    def wire(self, host: str) -> bytes:
        """Return the bytes of the request."""
        condition = f"If-None-Match: {self.etag}\r\n" if self.etag else ""
        return f"GET {self.path} HTTP/1.1\r\nHost: {host}\r\n{condition}\r\n".encode()


@dataclass(slots=True)
class Load:
    """What a load came to.

    seconds: from the first request to the last answer. cpu_seconds: of this process, meanwhile.
    bytes: of all answers, heads included.
    latencies: seconds, one per answer, ascending.
    statuses: how many answers had each status.
    """

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    bytes: int = 0
    latencies: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)

    @property
    def answers(self) -> int:
        """How many requests were answered."""
        return len(self.latencies)

    def quantile(self, share: float) -> float:
        """Return the latency, in seconds, that `share` of the answers did not exceed."""
        return self.latencies[min(int(share * len(self.latencies)), len(self.latencies) - 1)]


def send(url: str, requests: Sequence[Request], connections: int) -> Load:
    """Send all requests over so many connections, each in turn.

    Raises ConnectionError if a connection ends before its answer, TimeoutError after LOAD_SECONDS_MAX.
    """
    host = urlsplit(url).netloc
    wires = [request.wire(host) for request in requests]
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(_send(host, wires, connections))


async def _send(host: str, wires: list[bytes], connections: int) -> Load:
    load, left = Load(), iter(wires)
    name, _, port = host.rpartition(":")
    loop = asyncio.get_running_loop()
    opened = [
        await loop.create_connection(lambda: _Connection(load, left, loop.create_future()), name, int(port))
        for _ in range(connections)
    ]
    started, cpu_started = time.perf_counter(), time.process_time()
    for _, connection in opened:
        connection.send_next()
    try:
        async with asyncio.timeout(LOAD_SECONDS_MAX):
            await asyncio.gather(*(connection.done for _, connection in opened))
        load.seconds, load.cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
    finally:
        for transport, _ in opened:
            transport.close()
    load.latencies.sort()
    return load


class _Connection(asyncio.Protocol):
    """One connection: sends what is left, one request at a time, until nothing is."""

    def __init__(self, load: Load, left: Iterator[bytes], done: asyncio.Future[None]) -> None:
        self.done = done
        self._load = load
        self._left = left
        self._received = bytearray()
        self._wanted = 0
        self._sent = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its bases

    def send_next(self) -> None:
        """Send the next request, or be done."""
        wire = next(self._left, None)
        if wire is None:
            self.done.set_result(None)
            return
        self._received.clear()
        self._wanted = 0
        self._sent = time.perf_counter()
        self._transport.write(wire)

    def data_received(self, data: bytes) -> None:
        self._received += data
        if not self._wanted:
            self._wanted = _answer_bytes(self._received)
        if self._wanted and len(self._received) >= self._wanted:
            self._load.latencies.append(time.perf_counter() - self._sent)
            self._load.bytes += self._wanted
            self._load.statuses[self._received[9:12].decode()] += 1
            self.send_next()

    def connection_lost(self, error: Exception | None) -> None:
        if not self.done.done():
            self.done.set_exception(error or ConnectionResetError("the server closed a connection in use"))


def _answer_bytes(received: bytearray) -> int:
    """Return how many bytes the answer has that begins with `received`; 0 while its head is incomplete."""
    end = received.find(HEAD_END)
    if end < 0:
        return 0
    head = bytes(received[:end]).lower() + b"\r\n"
    if head[9:12] in WITHOUT_BODY:
        return end + len(HEAD_END)
    _, found, rest = head.partition(LENGTH)
    if not found:
        raise ValueError("an answer with a body has no Content-Length")
    return end + len(HEAD_END) + int(rest[: rest.index(b"\r\n")])
