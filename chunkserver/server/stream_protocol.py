"""One WebSocket: uvicorn's protocol, bounded. It takes over a connection that `protocol` has read the request of.

uvicorn bounds the length of a message and stops reading while one waits to be taken. It bounds neither how many pieces
a message comes in, nor what it answers to pings of a peer that does not read, nor how long a close may take; and a peer
could fill the log: with frames before the answer to its upgrade, or wrong ones while it is sent something. The tests of
this module fail if the parts of uvicorn that are relied on here change.
"""

import asyncio
import fcntl
import socket
import struct
import termios
from functools import partial
from typing import Any, Final, cast

from uvicorn.config import Config
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import CloseCode, Frame
from websockets.http11 import Request

from chunkserver.server.connections import Connections, Watched
from chunkserver.server.share import Share
from chunkserver.stream import closing, limits

ABORT: Final = "chunkserver.abort"
"""Where the ASGI scope of a WebSocket has what ends the connection at once, with all that is not sent yet."""
ENDED: Final = "chunkserver.ended"
"""Where it has what returns how the connection ended, as a `Close`, if the application has not closed it."""
SHARE: Final = "chunkserver.share"
"""Where it has the peer's `Share`: what the application does with its messages counts too."""
PIECES_MAX: Final = 64
"""Frames that one message may come in."""
PIECE_BYTES: Final = 2 << 10
"""What is parsed at once: frames of no bytes take 4 ms then. Between two pieces others get their turn."""
MESSAGE_BYTES_MAX: Final = limits.FRAME_BYTES_MAX + 125
"""That uvicorn takes: it counts a control frame in the middle of a message, too. The application looks again."""
UNREAD_BYTES_MAX: Final = 1 << 20
"""Of answers to pings, and others, that a peer has not read: with more, the connection ends."""
KERNEL_BYTES: Final = 1 << 16
"""Asked for what the kernel holds for a peer, and of it. It takes twice as much; without a word of ours, megabytes."""
FAULTS: Final = {each.code: each for each in (closing.NO_FRAME, closing.NOT_TEXT, closing.TOO_LARGE, closing.TOO_SLOW)}
"""What may be wrong with what comes."""
TCP_INFO_BYTES: Final = 128
BYTES_ACKED_AT: Final = 120
"""Of Linux's `struct tcp_info`: up to `tcpi_bytes_acked`, and where that stands."""
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
        self._share = Share(all_connections.shares)
        self._closing_looks = 0
        self._is_parting = False
        self._unparsed = b""
        self._is_due = self._is_held = False
        self._ended = closing.LOST
        self._ping_end = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Bound what the kernel holds, and for how long: else one who never reads has megabytes before it is seen."""
        super().connection_made(transport)
        held = transport.get_extra_info("socket")
        held.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BYTES)
        held.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, KERNEL_BYTES)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            held.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(limits.SEND_SECONDS * 1000))

    async def run_asgi(self) -> None:
        """Have the application serve it."""
        extensions: Any = self.scope["extensions"]
        extensions[ABORT] = self.transport.abort
        extensions[ENDED] = lambda: self._ended
        extensions[SHARE] = self._share
        await super().run_asgi()

    def data_received(self, data: bytes) -> None:
        """Take what has arrived: parse it, in pieces, as long as the peer's share is not spent."""
        if self._is_parting or self.transport.is_closing():
            return
        self._unparsed += data
        if self._share.rest_seconds:
            self._hold()
            self._parse_soon()
        elif not self._is_due:
            self._parse()

    async def receive(self) -> Any:
        """Return the next event for the application."""
        event = await super().receive()
        if self._is_held:  # uvicorn reads on, as soon as it has nothing for the application
            self._hold()
            self._parse_soon()
        return event

    def connection_lost(self, exc: Exception | None) -> None:
        """Note whether the kernel has given up a peer that took nothing for too long."""
        if isinstance(exc, TimeoutError):
            self._note_slow()
        super().connection_lost(exc)

    def send_keepalive_ping(self) -> None:
        """Ask whether the peer reads."""
        super().send_keepalive_ping()
        self._ping_end = self._taken_bytes() + self._waiting_bytes()

    def keepalive_timeout(self) -> None:
        """Close, if the peer's system has taken the ping. If not, the peer is to be judged by what it takes."""
        if self._taken_bytes() < self._ping_end:
            self.pong_timer = self.loop.call_later(self.ping_timeout or limits.PONG_SECONDS, self.keepalive_timeout)
        elif not self.close_sent and not self.transport.is_closing():
            self._all.count(NOT_READING)
            self.conn.fail(*closing.TOO_SLOW)
            self.handle_parser_exception()

    def handle_connect(self, event: Request) -> None:
        """Have an upgrade answered; what comes before the answer has to wait."""
        super().handle_connect(event)
        if not self.transport.is_closing():
            self._hold()

    async def send(self, message: Any) -> None:
        """Do what the application says. Raises `ClientDisconnected` if the connection is closed already."""
        await self.writable.wait()
        if self.close_sent:
            raise ClientDisconnected
        with self._share.used():
            await super().send(message)  # it waits for nothing more
        if message["type"] == "websocket.accept":
            self._parse_soon()
        if message["type"] == "websocket.http.response.body" and not message.get("more_body", False):
            self.handshake_complete = True  # refused, which is an answer too: uvicorn would log an error

    def handle_parser_exception(self) -> None:
        """Close because of what came, but not before the peer has stopped sending: else it may lose the close frame.

        To close with bytes unread resets the connection, and the peer's system throws away what it has not read yet.
        """
        if self._is_parting:
            return
        closed = self.conn.close_sent
        if closed is not None:
            self._ended = FAULTS.get(closed.code, closing.FAILED)
            self.queue.put_nowait({"type": "websocket.disconnect", "code": closed.code, "reason": closed.reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = self._is_parting = True
        self._unparsed = b""
        self.stop_keepalive()
        if self.close_timer is not None:
            self.close_timer.cancel()
        self.close_timer = self.loop.call_later(self._all.limits.linger_seconds, self.transport.close)
        self.transport.resume_reading()
        self.transport.write_eof()

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

    def handle_ping(self) -> None:
        """Answer a ping; but not one that came together with what the connection is closed for."""
        if not self._is_parting:
            super().handle_ping()

    def handle_close(self, event: Frame) -> None:
        """Take the peer's close; likewise."""
        if not self._is_parting:
            self._ended = closing.LEFT
            super().handle_close(event)

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

    # Inside

    def _parse(self) -> None:
        """Parse the next piece, unless what was parsed has to be taken before; the rest when others had their turn."""
        self._is_due = False
        is_opening = self.handshake_initiated and not self.handshake_complete
        if self._is_parting or is_opening or self.read_paused or self.transport.is_closing():
            return
        with self._share.used():
            piece, self._unparsed = self._unparsed[:PIECE_BYTES], self._unparsed[PIECE_BYTES:]
            if piece:
                super().data_received(piece)
        if self.transport.get_write_buffer_size() > UNREAD_BYTES_MAX:
            self._give_up()
        elif self._unparsed:
            self._hold()
            self._parse_soon()
        elif self._is_held and not self.read_paused and (self.handshake_complete or not self.handshake_initiated):
            self._is_held = False
            self.transport.resume_reading()

    def _parse_soon(self) -> None:
        """Parse on when others had their turn: a long one, if the peer has had its share."""
        if not self._is_due:
            self._is_due = True
            self.loop.call_later(self._share.rest_seconds, self._parse)

    def _hold(self) -> None:
        """Read no more for now."""
        self._is_held = True
        if not self.transport.is_closing():
            self.transport.pause_reading()

    def _taken_bytes(self) -> int:
        """Return how many bytes the peer's system has taken; 0 if this one does not tell."""
        if not hasattr(socket, "TCP_INFO"):
            return 0
        told = self.transport.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
        return struct.unpack_from("=Q", told, BYTES_ACKED_AT)[0] if len(told) == TCP_INFO_BYTES else 0

    def _waiting_bytes(self) -> int:
        """Return how many bytes are to be taken yet; 0 if this system does not tell."""
        if not hasattr(socket, "TCP_INFO"):
            return 0
        told = fcntl.ioctl(self.transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        return int(struct.unpack("=i", told)[0]) + self.transport.get_write_buffer_size()

    def _note_slow(self) -> None:
        if self._ended is closing.LOST:
            self._ended = closing.TOO_SLOW
            self._all.count(NOT_READING)

    def _give_up(self) -> None:
        self._note_slow()
        self.transport.abort()


def streaming(connections: Connections) -> type[asyncio.Protocol]:
    """Return what uvicorn takes for its `ws`: it makes the protocol of each WebSocket."""
    return cast(type[asyncio.Protocol], partial(StreamProtocol, all_connections=connections))
