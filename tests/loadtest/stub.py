"""A small server that answers as a test tells it to, in a thread of its own."""

import asyncio
import json
import re
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from tests.listening import close, turns

JOIN_SECONDS_MAX: Final = 10.0
KEY: Final = (2, -3, 0, 5)
"""Of the chunk that docs/wire/native-v1.md has as its example: 32 cells, half a metre a voxel."""
TAG: Final = '"0123456789abcdef0123456789abcdef"'
MEDIA_TYPE: Final = "application/vnd.chunkserver.mesh"

PAUSE_SECONDS: Final = 0.01
"""Between the pieces of an answer."""

Pieces = bytes | list[bytes]
"""An answer as it is sent. An empty piece ends the connection."""
Reply = Callable[[str], Pieces | Awaitable[Pieces]]
"""From the head of a request to its answer."""


def example(name: str) -> bytes:
    """Return the bytes of an example of docs/wire/native-v1.md."""
    page = (Path(__file__).parents[2] / "docs" / "wire" / "native-v1.md").read_text()
    dump = re.search(rf"```hex {name}\n(.*?)```", page, re.DOTALL)
    assert dump
    return b"".join(bytes.fromhex(line[4:]) for line in dump[1].splitlines())


def answer(status: str, body: bytes = b"", **fields: str) -> bytes:
    """Return the bytes of an answer. fields: names with underscores; an empty value leaves a field out."""
    length = fields.pop("length", str(len(body)))
    told = {"etag": TAG, "content_type": MEDIA_TYPE, "chunk_content": "surface"} | fields
    lines = [f"{name.replace('_', '-')}: {value}" for name, value in told.items() if value]
    if body or not status.startswith(("204", "304")):
        lines.append(f"content-length: {length}")
    return "\r\n".join([f"HTTP/1.1 {status}", *lines, "", ""]).encode() + body


OK: Final = answer("200 OK", example("std"))


def descriptor() -> bytes:
    """Return the answer that describes a world in which only KEY's column is asked for by these tests."""
    content = {
        "generator": "stub",
        "voxel_size": 0.5,
        "chunk_cells": 32,
        "lods": 3,
        "bounds": {"min": [-(1 << 40)] * 3, "max": [1 << 40] * 3},
        "urls": {"chunk": "/v1/seeds/42/chunks/{lod}/{x}/{y}/{z}{extension}?recipe=terrain"},
        "formats": [{"name": "mesh", "extension": ".mesh", "media_type": MEDIA_TYPE}],
    }
    return answer("200 OK", json.dumps(content).encode(), content_type="application/json")


class Server:
    """requests: the heads that came. open_most: connections at once."""

    def __init__(self, reply: Reply) -> None:
        self.requests: list[str] = []
        self.open_most = 0
        self.url = ""
        self._open: set[asyncio.StreamWriter] = set()
        self._writers: list[asyncio.StreamWriter] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._reply = reply
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._over = asyncio.Event()
        self._thread = threading.Thread(target=self._run)

    def start(self) -> None:
        """Listen."""
        self._thread.start()
        assert self._ready.wait(JOIN_SECONDS_MAX)

    def stop(self) -> None:
        """End, whatever is being answered."""
        with suppress(RuntimeError):  # it has ended already
            self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(JOIN_SECONDS_MAX)
        assert not self._thread.is_alive()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._answer_all, "127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        self._ready.set()
        await self._over.wait()
        await close(server)
        for writer in self._writers:  # before their tasks close them, which would wait for what is not written yet
            writer.transport.abort()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks)
        await turns()  # transports close some turns later

    async def _answer_all(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task
        self._tasks.add(task)
        self._open.add(writer)
        self._writers.append(writer)
        self.open_most = max(self.open_most, len(self._open))
        with suppress(ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            while head := (await reader.readuntil(b"\r\n\r\n")).decode():
                self.requests.append(head)
                if length := re.search(r"content-length: (\d+)", head, re.IGNORECASE):
                    await reader.readexactly(int(length[1]))
                replied = self._reply(head)
                pieces = replied if isinstance(replied, bytes | list) else await replied
                if not await _write(writer, pieces):
                    break
        self._open.discard(writer)
        self._tasks.discard(task)
        writer.close()


async def _write(writer: asyncio.StreamWriter, pieces: Pieces) -> bool:
    """Write an answer, and return whether the connection goes on."""
    for number, piece in enumerate([pieces] if isinstance(pieces, bytes) else pieces):
        if number:
            await asyncio.sleep(PAUSE_SECONDS)
        if not piece:
            return False
        writer.write(piece)
        await writer.drain()
    return True


@contextmanager
def answering(reply: Reply | Pieces) -> Iterator[Server]:
    """Yield a server, which ends with the block."""
    server = Server((lambda _head: reply) if isinstance(reply, bytes | list) else reply)
    server.start()
    try:
        yield server
    finally:
        server.stop()


def path(head: str) -> str:
    """Return the path of a request."""
    return head.split()[1]
