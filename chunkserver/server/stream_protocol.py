"""One WebSocket: uvicorn's protocol, bounded. It takes over a connection that `protocol` has read the request of.

uvicorn bounds the length of a message and stops reading while one waits to be taken. It bounds neither how many pieces
a message comes in, nor what it answers to pings of a peer that does not read, nor how long a close may take; and a peer
could fill the log. The tests of this module fail if the parts of uvicorn that are relied on here change.
"""

import asyncio
import socket
from functools import partial
from typing import Any, Final, cast

from uvicorn.config import Config
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import CloseCode, Frame

from chunkserver.server.connections import Connections, Watched
from chunkserver.stream import limits

ABORT: Final = "chunkserver.abort"
"""Where the ASGI scope of a WebSocket has what ends the connection at once, with all that is not sent yet."""
PIECES_MAX: Final = 64
"""Frames that one message may come in."""
UNREAD_BYTES_MAX: Final = 1 << 20
"""Of answers to pings, and others, that a peer has not read: with more, the connection ends."""
KERNEL_BYTES: Final = 1 << 16
"""Asked for what the kernel holds for a peer. It takes twice as much; without a word of ours, megabytes."""
NOT_READING: Final = "not-reading"
LINGERING: Final = "lingering"


class StreamProtocol(WebSocketsSansIOProtocol, Watched):
    """One WebSocket connection. uvicorn makes one for each request that asks for it."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        all_connections: Connections,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._all = all_connections
        self._closing_looks = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Bound what the kernel holds, and for how long: else one who never reads has megabytes before it is seen."""
        super().connection_made(transport)
        held = transport.get_extra_info("socket")
        held.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BYTES)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            held.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(limits.SEND_SECONDS * 1000))

    async def run_asgi(self) -> None:
        """Have the application serve it."""
        extensions: Any = self.scope["extensions"]
        extensions[ABORT] = self.transport.abort
        await super().run_asgi()

    def data_received(self, data: bytes) -> None:
        """Take what has arrived."""
        if not self.transport.is_closing():
            super().data_received(data)
        if self.transport.get_write_buffer_size() > UNREAD_BYTES_MAX:
            self._all.count(NOT_READING)
            self.transport.abort()

    async def send(self, message: Any) -> None:
        """Do what the application says."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body", False):
            self.handshake_complete = True  # refused, which is an answer too: uvicorn would log an error

    def send_receive_event_to_app(self) -> None:
        """Hand on a whole message: uvicorn would log an error for text that is none."""
        if self.curr_msg_data_type == "text":
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.conn.fail(CloseCode.INVALID_DATA, "text that is not UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def handle_cont(self, event: Frame) -> None:
        """Take one more piece of a message."""
        if len(self.frames) >= PIECES_MAX:
            self.conn.fail(CloseCode.MESSAGE_TOO_BIG, f"a message comes in more than {PIECES_MAX} frames")
            self.handle_parser_exception()
            return
        super().handle_cont(event)

    # What `Connections` calls

    def look(self) -> int:
        """See `Watched`. It never waits for a request; that it is used is for the application to see to."""
        self._closing_looks = self._closing_looks + 1 if self.transport.is_closing() else 0
        if self._closing_looks > self._all.looks_in(self._all.limits.linger_seconds):
            self._all.count(LINGERING)
            self.transport.abort()
        return 0

    def give_way(self) -> bool:
        """See `Watched`."""
        return False


def streaming(connections: Connections) -> type[asyncio.Protocol]:
    """Return what uvicorn takes for its `ws`: it makes the protocol of each WebSocket."""
    return cast(type[asyncio.Protocol], partial(StreamProtocol, all_connections=connections))
