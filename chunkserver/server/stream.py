"""The stream of a world's edits as a WebSocket: what is read goes in, what waits goes out, a task each."""

import asyncio
from typing import Final

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect, WebSocketState

from chunkserver.errors import BadParameter, ChunkError
from chunkserver.server.access import scope_of
from chunkserver.server.keys import Scope
from chunkserver.server.problems import OriginRefused, refusal
from chunkserver.server.service import Service
from chunkserver.server.share import Share
from chunkserver.server.stream_protocol import ABORT, ENDED, SHARE
from chunkserver.server.worlds import WORLD
from chunkserver.stream import Connection, closing

STREAM_PATH: Final = f"{WORLD}/stream"
SUBPROTOCOL: Final = "chunkserver.v1"
GONE: Final = (OSError, WebSocketDisconnect)
"""What is raised when something is sent to a peer that is gone: no fault of anybody's."""
CLOSE_SECONDS: Final = 1.0
"""For a close frame to get into the connection's buffer."""

router: Final = APIRouter()


@router.websocket(STREAM_PATH)
async def world_stream(websocket: WebSocket, world: str) -> None:
    """Edits in, answers and the edits of others out: docs/wire/edit_v1.md."""
    service: Service = websocket.app.state.service
    try:
        found = service.worlds.find(world)
        scope = _scope(websocket, service)
        if SUBPROTOCOL not in websocket.scope["subprotocols"]:
            offered = ", ".join(websocket.scope["subprotocols"]) or "none"
            raise BadParameter(f"this is a WebSocket of subprotocol {SUBPROTOCOL}; offered: {offered}", offered=offered)
        session = _Session(websocket)
        session.connection = await service.streams.connect(found, session.wake, may_edit=scope.covers(Scope.EDIT))
    except ChunkError as error:
        await websocket.send_denial_response(refusal(websocket, error))
        return
    try:
        await session.run()
    finally:
        service.streams.left(session.connection, websocket.scope["extensions"][ENDED]())


def _scope(websocket: WebSocket, service: Service) -> Scope:
    """Return what may be done over this connection. Raises `OriginRefused` if its page may not even read."""
    granted, headers = scope_of(websocket.scope), dict(websocket.scope["headers"])
    origin = headers.get(b"origin")
    if origin is None or origin.partition(b"://")[2] == headers.get(b"host") or service.cors.names(origin):
        return granted
    if service.cors.any:
        return Scope.READ
    shown = origin.decode("latin-1")
    raise OriginRefused(f"pages of {shown} may not use this server: `cors_origins` does not name it", origin=shown)


class _Session:
    """One WebSocket and its connection, until one of the two ends."""

    connection: Connection

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket = websocket
        self._can_send, self._can_read = asyncio.Event(), asyncio.Event()
        self._ended = asyncio.Event()

    def wake(self) -> None:
        """Take that the connection has something to send, may be read again, or is closed."""
        self._can_send.set()
        self._can_read.set()
        if self.connection.closing is not None:
            self._ended.set()

    async def run(self) -> None:
        """Carry messages both ways. Returns when the peer is gone, or the WebSocket is closed."""
        await self._websocket.accept(SUBPROTOCOL)
        tasks = [asyncio.ensure_future(each) for each in (self._read(), self._send(), self._ended.wait())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            found = await asyncio.gather(*tasks, return_exceptions=True)
        await self._close()
        for each in found:
            if isinstance(each, Exception) and not isinstance(each, GONE):
                raise each

    async def _read(self) -> None:
        share: Share = self._websocket.scope["extensions"][SHARE]
        while True:
            while self.connection.is_paused:
                self._can_read.clear()
                await self._can_read.wait()
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            with share.used():
                self.connection.received(message["bytes"] if text is None else text)
            if rest_seconds := share.rest_seconds:
                await asyncio.sleep(rest_seconds)

    async def _send(self) -> None:
        outbox = self.connection.outbox
        while True:
            frame = outbox.front()
            if frame is None:
                self._can_send.clear()
                await self._can_send.wait()
            else:
                await self._websocket.send({"type": "websocket.send", "text": frame.decode()})
                self.connection.sent()

    async def _close(self) -> None:
        """Close the WebSocket as the connection was; at once, if its peer takes nothing."""
        why = self.connection.closing
        if why is None or self._websocket.client_state is WebSocketState.DISCONNECTED:
            return
        try:
            async with asyncio.timeout(0 if why is closing.TOO_SLOW else CLOSE_SECONDS):
                await self._websocket.close(why.code, why.reason)
        except TimeoutError:
            self._websocket.scope["extensions"][ABORT]()
        except GONE:
            pass
