"""A TCP proxy that does to answers what networks do, by a script: one fault for each request, then none any more.

with chaos(server.url, cut_short(100), refuse(retry_after="1")) as proxy:
    Client(proxy.url)

A connection carries one request. The proxy has a thread and an event loop of its own, and ends within
`STOP_SECONDS_MAX`.
"""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Final
from urllib.parse import urlsplit

from tests.listening import close

HEAD_BYTES_MAX: Final = 1 << 16
PIECE_BYTES: Final = 1 << 16
EXCHANGE_SECONDS_MAX: Final = 60.0
STOP_SECONDS_MAX: Final = 10.0
JUNK: Final = bytes(range(256)) * 4


class Exchange:
    """One request, the server that it is for, and the client that waits for an answer."""

    def __init__(self, request: bytes, target: str, client: asyncio.StreamWriter) -> None:
        self._request = request
        self._target = urlsplit(target)
        self._client = client

    async def send(self, piece: bytes) -> None:
        """Send some of an answer to the client."""
        self._client.write(piece)
        await self._client.drain()

    async def answer(self) -> tuple[bytes, asyncio.StreamReader]:
        """Ask the server. Return the head of its answer, and where the body is to be read."""
        reader, writer = await asyncio.open_connection(self._target.hostname, self._target.port)
        writer.write(self._request.replace(b"\r\n", b"\r\nConnection: close\r\n", 1))
        await writer.drain()
        self._upstream = writer
        return await reader.readuntil(b"\r\n\r\n"), reader

    def close(self) -> None:
        """Close the connection to the server, if there is one."""
        if hasattr(self, "_upstream"):
            self._upstream.close()


Fault = Callable[[Exchange], Awaitable[None]]
"""What is done instead of handing an answer on. When it returns, the connection is closed."""


async def none(exchange: Exchange) -> None:
    """Hand the answer on as it comes."""
    head, body = await exchange.answer()
    await exchange.send(head)
    while piece := await body.read(PIECE_BYTES):
        await exchange.send(piece)


async def hang_up(_exchange: Exchange) -> None:
    """Close before there is any answer."""


async def junk(exchange: Exchange) -> None:
    """Answer with what is not HTTP."""
    await exchange.send(JUNK)


def cut_short(count: int) -> Fault:
    """Close after `count` bytes of the body."""

    async def fault(exchange: Exchange) -> None:
        head, body = await exchange.answer()
        await exchange.send(head)
        left = count
        while left and (piece := await body.read(left)):
            await exchange.send(piece)
            left -= len(piece)

    return fault


def flip(offset: int, mask: int = 0xFF, magic: bytes = b"") -> Fault:
    """Change the byte at `offset` behind where `magic` begins in the body: its length is right, its content is not."""

    async def fault(exchange: Exchange) -> None:
        head, body = await exchange.answer()
        content = bytearray(await body.read(-1))
        content[content.index(magic) + offset] ^= mask
        await exchange.send(head + content)

    return fault


def stall(seconds: float, after: int = 0) -> Fault:
    """Wait in the middle of the body, then go on."""

    async def fault(exchange: Exchange) -> None:
        head, body = await exchange.answer()
        await exchange.send(head + await body.read(after))
        await asyncio.sleep(seconds)
        await exchange.send(await body.read(-1))

    return fault


def drip(count: int, seconds: float) -> Fault:
    """Send `count` bytes at a time, with a pause behind each."""

    async def fault(exchange: Exchange) -> None:
        head, body = await exchange.answer()
        await exchange.send(head)
        while piece := await body.read(count):
            await exchange.send(piece)
            await asyncio.sleep(seconds)

    return fault


def reply(status: str, *headers: str, body: bytes = b"") -> Fault:
    """Answer in the server's place."""

    async def fault(exchange: Exchange) -> None:
        lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", "Connection: close", *headers]
        await exchange.send("\r\n".join([*lines, "\r\n"]).encode() + body)

    return fault


def refuse(retry_after: str) -> Fault:
    """Answer 503 in the server's place."""
    return reply("503 Service Unavailable", f"Retry-After: {retry_after}")


class Proxy:
    """A running proxy.

    requests, bodies: head, in lower case, and body of each request that came.
    target: the server's URL; it may be changed.
    """

    def __init__(self, target: str, faults: tuple[Fault, ...]) -> None:
        self.target = target
        self.requests: list[str] = []
        self.bodies: list[str] = []
        self.url = ""
        self._faults = list(faults)
        self._exchanges: set[asyncio.Task[None]] = set()
        self._ready = threading.Event()
        self._ended: asyncio.Event
        self._loop: asyncio.AbstractEventLoop
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)

    def start(self) -> None:
        """Listen on a free port of the loopback interface."""
        self._thread.start()
        assert self._ready.wait(STOP_SECONDS_MAX)

    def stop(self) -> None:
        """End all exchanges where they are."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(STOP_SECONDS_MAX)
        assert not self._thread.is_alive()

    def hang_up(self) -> None:
        """End all exchanges where they are, and go on listening."""
        self._loop.call_soon_threadsafe(lambda: [task.cancel() for task in self._exchanges])

    async def _serve(self) -> None:
        self._ended, self._loop = asyncio.Event(), asyncio.get_running_loop()
        server = await asyncio.start_server(self._connected, "127.0.0.1", 0, limit=HEAD_BYTES_MAX)
        self.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        self._ready.set()
        await self._ended.wait()
        await close(server)
        for task in self._exchanges:
            task.cancel()
        await asyncio.gather(*self._exchanges, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        exchange = asyncio.ensure_future(self._exchange(reader, writer))
        self._exchanges.add(exchange)
        try:
            await asyncio.wait_for(exchange, EXCHANGE_SECONDS_MAX)
        except asyncio.CancelledError:
            pass  # the proxy hangs up
        except (OSError, asyncio.IncompleteReadError, TimeoutError):
            pass  # one of both sides has left, or does not listen: the other one sees a closed connection
        finally:
            self._exchanges.discard(exchange)
            writer.close()

    async def _exchange(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readuntil(b"\r\n\r\n")
        text = head.decode("latin-1").lower()
        _, _, length = text.partition("\r\ncontent-length: ")
        body = await reader.readexactly(int(length.partition("\r\n")[0] or 0))
        self.requests.append(text)
        self.bodies.append(body.decode("latin-1"))
        exchange = Exchange(head + body, self.target, writer)
        try:
            await (self._faults.pop(0) if self._faults else none)(exchange)
        finally:
            exchange.close()


@contextmanager
def chaos(target: str, *faults: Fault) -> Iterator[Proxy]:
    """Run a proxy in front of the server at the URL `target`."""
    proxy = Proxy(target, faults)
    proxy.start()
    try:
        yield proxy
    finally:
        proxy.stop()
