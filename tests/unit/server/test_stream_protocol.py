"""WebSockets between a peer that does as it likes and an application that does not know it yet."""

import asyncio
import socket
from contextlib import suppress
from typing import Any

from uvicorn.config import Config
from uvicorn.server import ServerState

from chunkserver.server.connections import Connections
from chunkserver.server.stream_protocol import ENDED, streaming
from chunkserver.stream import closing
from chunkserver.stream.closing import Close
from tests.frames import CLOSE, FIN, PONG, TEXT, Frame

UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
WRONG = Frame(FIN | TEXT, b"{}", masked=False)


async def serving(app: Any, **options: Any) -> asyncio.Server:
    """Return a server of WebSockets. options: of uvicorn."""
    config = Config(app, ws_per_message_deflate=False, **options)
    config.load()
    return await asyncio.get_running_loop().create_server(
        lambda: streaming(Connections())(config, ServerState(), {}),  # type: ignore[call-arg]
        "127.0.0.1",
    )


async def raised_by(*messages: dict[str, Any]) -> list[type]:
    """Return what each message of the application raises that it sends behind a wrong frame of its peer."""
    raised: list[type] = []
    over = asyncio.Event()

    async def app(_scope: Any, receive: Any, send: Any) -> None:
        assert (await receive())["type"] == "websocket.connect"
        await send({"type": "websocket.accept"})
        assert (await receive()) == {"type": "websocket.disconnect", "code": 1002, "reason": "incorrect masking"}
        for message in messages:
            try:
                await send(message)
            except Exception as error:  # noqa: BLE001 - that is the question
                raised.append(type(error))
        over.set()

    async with await serving(app) as server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        writer.write(UPGRADE)
        await reader.readuntil(b"\r\n\r\n")
        writer.write(WRONG.encoded())
        await asyncio.wait_for(over.wait(), 10.0)
        writer.close()
    return raised


def test_what_is_sent_to_a_peer_that_is_closed_is_sent_to_nobody():
    """uvicorn would call it an unexpected message of the application, and log it as a fault."""
    sent = {"type": "websocket.send", "text": "{}"}, {"type": "websocket.close", "code": 4400}
    raised = asyncio.run(raised_by(*sent))
    assert [issubclass(each, OSError) for each in raised] == [True, True]


async def end_of(sent_bytes: int, *, answers: bool) -> tuple[int, Close]:
    """Return how many bytes there are for a peer that reads nothing for a while, and then all; and how it ended.

    sent_bytes: that the application has for it at once. answers: whether it answers pings then.
    """
    ended: list[Close] = []
    over = asyncio.Event()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.send", "text": "x" * sent_bytes})
        while (await receive())["type"] != "websocket.disconnect":
            pass
        ended.append(scope["extensions"][ENDED]())
        over.set()

    async with await serving(app, ws_ping_interval=PING_SECONDS, ws_ping_timeout=PONG_SECONDS) as server:
        with socket.socket() as peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            peer.connect(server.sockets[0].getsockname())
            peer.setblocking(False)
            loop, found = asyncio.get_running_loop(), b""
            await loop.sock_sendall(peer, UPGRADE)
            await asyncio.sleep(AWAY_SECONDS)
            while not over.is_set():
                with suppress(TimeoutError):
                    found += await asyncio.wait_for(loop.sock_recv(peer, 1 << 20), 0.02)
                if answers and (at := found.find(b"\x89\x04")) >= 0 and len(found) >= at + 6:
                    await loop.sock_sendall(peer, Frame(FIN | PONG, found[at + 2 : at + 6]).encoded())
                    await loop.sock_sendall(peer, Frame(FIN | CLOSE).encoded())
                    answers = False
        await asyncio.wait_for(over.wait(), 10.0)
    return len(found), ended[0]


PING_SECONDS, PONG_SECONDS, AWAY_SECONDS = 0.05, 0.15, 0.6


def test_who_has_room_and_does_not_answer_a_ping_is_gone():
    size, end = asyncio.run(end_of(10, answers=False))
    assert (size < 1000, end) == (True, closing.TOO_SLOW)


def test_who_has_not_got_the_ping_yet_may_answer_it_late():
    size, end = asyncio.run(end_of(300_000, answers=True))
    assert (size > 300_000, end) == (True, closing.LEFT)
