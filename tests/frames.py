"""WebSockets without a library: frames byte by byte, right and wrong ones."""

import socket
import struct
from typing import NamedTuple, Self

import httpx2

TEXT, BINARY, CONT, CLOSE, PING, PONG = 1, 2, 0, 8, 9, 10
FIN = 0x80
SHORT_MAX = 125
"""Bytes of a frame whose length stands in the first two bytes, and of a control frame."""
NO_CODE = 1005
"""RFC 6455: stands for a close frame without a code. So does 0 here for no close frame at all."""
MASK = bytes(4)
"""Changes nothing."""


class Frame(NamedTuple):
    """A frame of a client.

    first: its first byte. claimed: its length as it says, if not that of the payload.
    size: in how many bytes the length stands, 1, 3 or 9; as few as can be, if 0.
    """

    first: int
    payload: bytes = b""
    masked: bool = True
    claimed: int | None = None
    size: int = 0

    @property
    def length(self) -> int:
        """The length that it says it has."""
        return len(self.payload) if self.claimed is None else self.claimed

    @property
    def is_wide(self) -> bool:
        """Whether the length stands in more bytes than it needs."""
        return self.size > self._least

    @property
    def is_whole(self) -> bool:
        """Whether all that it says is there, and not more."""
        return self.length == len(self.payload)

    def encoded(self) -> bytes:
        """Return its bytes."""
        bit, length = 0x80 if self.masked else 0, self.length
        heads = {
            1: lambda: bytes([self.first, bit | length]),
            3: lambda: struct.pack(">BBH", self.first, bit | 126, length),
            9: lambda: struct.pack(">BBQ", self.first, bit | 127, length),
        }
        return heads[max(self.size, self._least)]() + (MASK if self.masked else b"") + self.payload

    @property
    def _least(self) -> int:
        return 1 if self.length <= SHORT_MAX else 3 if self.length < 1 << 16 else 9


class Raw:
    """A connection to a world's stream that sends what it likes."""

    def __init__(self, url: str, seconds: float = 20.0, *, answered: bool = True) -> None:
        """url: of the world. seconds: how long it waits for anything. answered: whether to wait until it is open."""
        address = httpx2.URL(url)
        self.socket = socket.create_connection((address.host, address.port), seconds)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.sendall(
            b"GET %s/stream HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Protocol: chunkserver.v1\r\n\r\n" % address.raw_path
        )
        self._unread = bytearray()
        if not answered:
            return
        while (end := self._unread.find(b"\r\n\r\n")) < 0:
            self._more()
        assert self._unread.startswith(b"HTTP/1.1 101"), bytes(self._unread)
        del self._unread[: end + 4]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, *frames: Frame) -> None:
        """Send frames together."""
        self.socket.sendall(b"".join(frame.encoded() for frame in frames))

    def receive(self) -> tuple[int, bytes]:
        """Return the opcode and the payload of the next frame. Raises `EOFError` if the server ends the connection."""
        self._need(2)
        assert self._unread[0] & 0xF0 == FIN, f"a frame of the server begins with {self._unread[0]:#x}"
        assert not self._unread[1] & 0x80, "the server masks nothing"
        start = {126: 4, 127: 10}.get(self._unread[1], 2)
        self._need(start)
        length = self._unread[1] if start == 2 else int.from_bytes(self._unread[2:start], "big")
        self._need(start + length)
        found = self._unread[0] & 0x0F, bytes(self._unread[start : start + length])
        del self._unread[: start + length]
        return found

    def code(self) -> int:
        """Return the code of the close frame; 0 if the connection ends without one."""
        try:
            while (found := self.receive())[0] != CLOSE:
                pass
        except EOFError:
            return 0
        return code_of(found[1])

    def ends(self) -> bool:
        """Say that nothing more comes. Return whether the server then ends the connection, and not by a reset."""
        try:
            self.socket.shutdown(socket.SHUT_WR)
            while self.socket.recv(1 << 16):
                pass
        except OSError:
            return False
        return True

    def _need(self, size: int) -> None:
        while len(self._unread) < size:
            self._more()

    def _more(self) -> None:
        piece = self.socket.recv(1 << 16)
        if not piece:
            raise EOFError("the server ends the connection")
        self._unread += piece


def code_of(payload: bytes) -> int:
    """Return the code that a close frame carries."""
    return int.from_bytes(payload[:2], "big") if payload else NO_CODE
