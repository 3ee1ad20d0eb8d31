"""One peer of a world's stream of edits, as docs/wire/edit_v1.md has it: little work for each frame, of any number.

What many peers are told is the same bytes; they are read once for all. A peer checks what any client has to: that each
message leads on from what is known, and that every edit is answered.
"""

import asyncio
import json
import struct
import time
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Final, cast

SUBPROTOCOL: Final = "chunkserver.v1"
FRAME_BYTES_MAX: Final = 1 << 16
HEAD_BYTES_MAX: Final = 1 << 16
READ_ONCE_MAX: Final = 256
"""Messages that are remembered while other peers are told the same."""
Regions = tuple[Mapping[str, Any], ...]
EVERYWHERE: Final[Regions] = ({"min": [-(1 << 40)] * 3, "max": [1 << 40] * 3},)
TEXT, CLOSE, PING, PONG = 0x81, 0x88, 0x89, 0x8A
LONG: Final = 126
"""Written for the length of a frame whose length stands behind it, in 16 bits; one more, and it is 64."""

Message = dict[str, Any]


class Peer(asyncio.Protocol):
    """One connection.

    known: the revision up to which everything is known; None before `welcome`. epoch: of its world.
    heard: called with each message and the moment it came. lost: called once, when the connection is over and `close`
        was not called, with why: a code of the protocol, a fault, or "closed".
    """

    def __init__(
        self,
        address: bytes,
        client: str,
        heard: Callable[["Peer", Message, float], None],
        lost: Callable[["Peer", str], None],
        *,
        regions: Regions = EVERYWHERE,
        epoch: str | None = None,
        known: int | None = None,
    ) -> None:
        """address: what `upgrade` returns. regions: where to look. epoch, known: to go on from."""
        self.client = client
        self.known, self.epoch = known, epoch
        self._address, self._heard, self._lost, self._regions = address, heard, lost, regions
        self._unread = bytearray()
        self._is_open = self._is_over = False

    def send(self, kind: str, **members: Any) -> None:
        """Send a message."""
        self._write(TEXT, json.dumps({"type": kind, **members}, separators=(",", ":")).encode())

    def close(self) -> None:
        """End the connection at once; nobody is told."""
        self._is_over = True
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.write(self._address)

    def data_received(self, data: bytes) -> None:
        moment = time.perf_counter()
        self._unread += data
        if not self._is_open and not self._opened():
            return
        while not self._is_over and (frame := self._next()) is not None:
            self._take(*frame, moment)

    def connection_lost(self, error: Exception | None) -> None:
        self._end(f"closed {error or ''}".strip())

    def _opened(self) -> bool:
        """Read the answer to the upgrade, if all of it is there, and introduce the peer."""
        end = self._unread.find(b"\r\n\r\n")
        if end < 0:
            return False
        if not self._unread.startswith(b"HTTP/1.1 101 "):
            self._end(self._unread[: self._unread.find(b"\r\n")].decode("latin-1"))
            return False
        del self._unread[: end + 4]
        self._is_open = True
        resume = None if self.known is None else str(self.known)
        self.send("hello", client=self.client, epoch=self.epoch, resume=resume, regions=self._regions)
        return True

    def _next(self) -> tuple[int, bytes] | None:
        """Return the first byte and the payload of the next frame; None if it is not all there."""
        unread = self._unread
        if len(unread) < 2:
            return None
        start, length = 2, unread[1]
        if length >= LONG:
            start = 4 if length == LONG else 10
            if len(unread) < start:
                return None
            length = int.from_bytes(unread[2:start], "big")
        if length > FRAME_BYTES_MAX:
            self._end(f"a frame of {length} bytes")
            return None
        if len(unread) < start + length:
            return None
        found = unread[0], bytes(unread[start : start + length])
        del unread[: start + length]
        return found

    def _take(self, first: int, payload: bytes, moment: float) -> None:
        if first == TEXT:
            message = read_once(payload)
            self._learn(message)
            if not self._is_over:
                self._heard(self, message, moment)
        elif first == PING:
            self._write(PONG, payload)
        elif first == CLOSE:
            self._end(str(int.from_bytes(payload[:2], "big")))
        else:
            self._end(f"a frame that begins with {first:#x}")

    def _learn(self, message: Message) -> None:
        """Move on what is known. A message that does not lead on from there ends the connection."""
        kind = message["type"]
        if kind == "welcome":
            if self.known is None or self.epoch != message["epoch"]:
                self.known, self.epoch = int(message["revision"]), message["epoch"]
        elif kind in ("edits", "progress", "stale", "resync"):
            assert self.known is not None
            revision = int(message["revision"])
            if revision < self.known or (kind == "edits" and int(message["after"]) != self.known):
                self._end(f"{kind} from {message.get('after')} to {revision}, where {self.known} is known")
            self.known = revision

    def _write(self, first: int, payload: bytes) -> None:
        """Send a frame; with a mask of zeros, which changes nothing."""
        length = len(payload)
        size = bytes([0x80 | length]) if length < LONG else struct.pack(">BH", 0x80 | LONG, length)
        self._transport.write(bytes([first]) + size + bytes(4) + payload)

    def _end(self, why: str) -> None:
        if not self._is_over:
            self.close()
            self._lost(self, why)


def upgrade(path: str, authority: str, fixed: bytes = b"") -> bytes:
    """Return the request that opens the stream of the world at `path`. fixed: header lines, each with its end."""
    return (
        (
            f"GET {path}/stream HTTP/1.1\r\nHost: {authority}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n"
        ).encode()
        + fixed
        + b"\r\n"
    )


@lru_cache(READ_ONCE_MAX)
def read_once(payload: bytes) -> Message:
    """Return the message of a frame. It is shared, and not to be changed."""
    found: Message = json.loads(payload)
    return found
