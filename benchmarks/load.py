"""A small HTTP/1.1 client for load: keep-alive connections, in a closed or an open loop, and little work per request.

It understands what our server sends and no more: Content-Length bodies, no chunked coding, no redirects.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, NamedTuple, cast
from urllib.parse import urlsplit

import uvloop

HEAD_END: Final = b"\r\n\r\n"
LENGTH: Final = b"\r\ncontent-length:"
WITHOUT_BODY: Final = (b"204", b"304")
LOAD_SECONDS_MAX: Final = 300.0
OPEN_CONNECTIONS_MAX: Final = 800
"""Of an open loop; a server takes 1,024 unless told otherwise."""
POLL_SECONDS: Final = 0.005
GOOD: Final = frozenset(("200", "204", "304"))


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
    latencies: seconds, one per answer, ascending. good_latencies: of the answers that are no errors, as they came.
    statuses: how many answers had each status.
    """

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    bytes: int = 0
    latencies: list[float] = field(default_factory=list)
    good_latencies: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)

    @property
    def answers(self) -> int:
        """How many requests were answered."""
        return len(self.latencies)

    def count(self, status: str, latency: float, answer_bytes: int) -> None:
        """Count one answer."""
        self.latencies.append(latency)
        self.bytes += answer_bytes
        self.statuses[status] += 1
        if status in GOOD:
            self.good_latencies.append(latency)

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


def offer(url: str, requests: Iterable[Request], rate: float, seconds: float) -> Load:
    """Send requests at a fixed rate, whether or not earlier ones are answered: an open loop, as many users are.

    rate: requests a second. seconds: for how long; then the answers that are still to come are waited for.
    Latencies count from when a request was due. One for which OPEN_CONNECTIONS_MAX others wait is not sent, and has no
    answer; so is one whose connection ends before its answer (status "end").

    Raises TimeoutError after LOAD_SECONDS_MAX.
    """
    host = urlsplit(url).netloc
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(_offer(host, (request.wire(host) for request in requests), rate, seconds))


async def _send(host: str, wires: list[bytes], connections: int) -> Load:
    load, left = Load(), iter(wires)
    done = asyncio.get_running_loop().create_future()
    busy = set()

    def ask_next(connection: _Connection) -> None:
        wire = next(left, None)
        if wire is not None:
            connection.ask(wire, time.perf_counter())
            return
        busy.discard(connection)
        if not busy and not done.done():
            done.set_result(None)

    def lost(_connection: _Connection, error: Exception | None) -> None:
        if not done.done():
            done.set_exception(error or ConnectionResetError("the server closed a connection in use"))

    opened = [await _connect(host, load, ask_next, lost) for _ in range(connections)]
    busy.update(opened)
    with _timed(load):
        for connection in opened:
            ask_next(connection)
        try:
            async with asyncio.timeout(LOAD_SECONDS_MAX):
                await done
        finally:
            for connection in opened:
                connection.close()
    return load


async def _offer(host: str, wires: Iterator[bytes], rate: float, seconds: float) -> Load:
    load, busy = Load(), set[_Connection]()
    idle: list[_Connection] = []

    def answered(connection: _Connection) -> None:
        busy.discard(connection)
        idle.append(connection)

    def lost(connection: _Connection, _error: Exception | None) -> None:
        if connection in busy:
            busy.discard(connection)
            load.statuses["end"] += 1
        else:
            idle.remove(connection)

    async def ask(wire: bytes, due: float) -> None:
        connection = idle.pop() if idle else await _connect(host, load, answered, lost)
        busy.add(connection)
        connection.ask(wire, due)

    async def ask_at_the_rate() -> None:
        asking = set[asyncio.Task[None]]()
        started = time.perf_counter()
        for number in range(int(rate * seconds)):
            due = started + number / rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            wire = next(wires)
            if len(busy) + len(asking) < OPEN_CONNECTIONS_MAX:
                task = asyncio.create_task(ask(wire, due))
                asking.add(task)
                task.add_done_callback(asking.discard)
        while asking or busy:
            await asyncio.sleep(POLL_SECONDS)

    try:
        with _timed(load):
            await asyncio.wait_for(ask_at_the_rate(), LOAD_SECONDS_MAX)
    finally:
        for connection in (*busy, *idle):
            connection.close()
    return load


@contextmanager
def _timed(load: Load) -> Iterator[None]:
    started, cpu_started = time.perf_counter(), time.process_time()
    yield
    load.seconds, load.cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
    load.latencies.sort()


async def _connect(
    host: str,
    load: Load,
    answered: Callable[["_Connection"], None],
    lost: Callable[["_Connection", Exception | None], None],
) -> "_Connection":
    name, _, port = host.rpartition(":")
    loop = asyncio.get_running_loop()
    _, connection = await loop.create_connection(lambda: _Connection(load, answered, lost), name, int(port))
    return connection


class _Connection(asyncio.Protocol):
    """One connection: sends a request, counts its answer in `load`, and says so; or that it was lost."""

    def __init__(
        self,
        load: Load,
        answered: Callable[["_Connection"], None],
        lost: Callable[["_Connection", Exception | None], None],
    ) -> None:
        self._load = load
        self._answered = answered
        self._lost = lost
        self._closed = False
        self._received = bytearray()
        self._wanted = 0
        self._due = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its bases

    def ask(self, wire: bytes, due: float) -> None:
        """Send a request; its latency counts from `due`."""
        self._received.clear()
        self._wanted = 0
        self._due = due
        self._transport.write(wire)

    def close(self) -> None:
        """End it; nobody is told."""
        self._closed = True
        self._transport.close()

    def data_received(self, data: bytes) -> None:
        self._received += data
        if not self._wanted:
            self._wanted = _answer_bytes(self._received)
        if self._wanted and len(self._received) >= self._wanted:
            self._load.count(self._received[9:12].decode(), time.perf_counter() - self._due, self._wanted)
            self._answered(self)

    def connection_lost(self, error: Exception | None) -> None:
        if not self._closed:
            self._lost(self, error)


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
