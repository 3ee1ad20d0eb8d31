"""A TCP proxy between players and a server, which a test cuts, holds still, and leads to another server.

with wire(server.url) as line:
    Client(line.url)
    line.cut()

It has a thread and an event loop of its own, and ends within `STOP_SECONDS_MAX`.
"""

import asyncio
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final
from urllib.parse import urlsplit

from tests.listening import close

PIECE_BYTES: Final = 1 << 16
STOP_SECONDS_MAX: Final = 10.0


class Wire:
    """A running proxy. target: the server's URL; None is none. opened: how many connections there were.

    tls: with which players connect, if they do; the server speaks plain HTTP in any case.
    """

    def __init__(self, target: str | None, tls: ssl.SSLContext | None = None) -> None:
        self.target = target
        self._tls = tls
        self.opened = 0
        self.url = ""
        self._open: dict[asyncio.StreamWriter, asyncio.Event] = {}
        self._ready = threading.Event()
        self._loop: asyncio.AbstractEventLoop
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Listen on a free port of the loopback interface."""
        self._thread.start()
        assert self._ready.wait(STOP_SECONDS_MAX)

    def stop(self) -> None:
        """Cut all connections, and listen no more."""
        self.cut()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_SECONDS_MAX)
        assert not self._thread.is_alive()

    def cut(self) -> None:
        """Break all connections as they are, without a word."""
        self._loop.call_soon_threadsafe(self._cut)

    def hold(self) -> None:
        """Hand nothing on any more on the connections that there are; new ones are as always."""
        self._loop.call_soon_threadsafe(self._hold)

    def _cut(self) -> None:
        for writer in self._open:
            writer.transport.abort()

    def _hold(self) -> None:
        for flows in self._open.values():
            flows.clear()

    def _run(self) -> None:
        with asyncio.Runner() as runner:
            self._loop = runner.get_loop()
            listening = runner.run(asyncio.start_server(self._connected, "127.0.0.1", 0, ssl=self._tls))
            self.url = f"{'https' if self._tls else 'http'}://127.0.0.1:{listening.sockets[0].getsockname()[1]}"
            self._ready.set()
            self._loop.run_forever()
            runner.run(close(listening))

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.opened += 1
        flows = asyncio.Event()
        flows.set()
        self._open[writer] = flows
        try:
            if self.target is not None:
                there = urlsplit(self.target)
                upstream = await asyncio.open_connection(there.hostname, there.port)
                self._open[upstream[1]] = flows
                await asyncio.gather(_pump(reader, upstream[1], flows), _pump(upstream[0], writer, flows))
        except (OSError, asyncio.CancelledError):
            pass  # one of both sides is gone
        finally:
            for each in [each for each, its in self._open.items() if its is flows]:
                del self._open[each]
                each.transport.abort()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, flows: asyncio.Event) -> None:
    while piece := await reader.read(PIECE_BYTES):
        await flows.wait()
        writer.write(piece)
        await writer.drain()
    with suppress(OSError):
        if writer.can_write_eof():
            writer.write_eof()
        else:  # there is no half of a TLS connection
            writer.close()


@contextmanager
def wire(target: str | None, tls: ssl.SSLContext | None = None) -> Iterator[Wire]:
    """Run a proxy in front of the server at the URL `target`."""
    line = Wire(target, tls)
    line.start()
    try:
        yield line
    finally:
        line.stop()
