"""One peer of a world's stream of edits, as docs/wire/edit_v1.md has it: little work for each frame, of any number.

What many peers are told is the same bytes; they are read once for all. A peer checks what any client has to: that each
message leads on from what is known, and that every edit is answered.
"""

import asyncio
import itertools
import json
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple, cast

SUBPROTOCOL: Final = "chunkserver.v1"
FRAME_BYTES_MAX: Final = 1 << 16
HEAD_BYTES_MAX: Final = 1 << 16
LINE_MAX: Final = 300
"""Characters of what came, where it is told."""
READ_ONCE_MAX: Final = 256
"""Messages that are remembered while other peers are told the same."""
FINAL: Final = frozenset({401, 403, 404, 422, 1009, 4400, 4401, 4404, 4409, 4412})
"""Statuses of an upgrade, and codes, after which another connection would end in the same way."""
TEXT, CLOSE, PING, PONG = 0x81, 0x88, 0x89, 0x8A
LONG: Final = 126
"""Written for the length of a frame whose length stands behind it, in 16 bits; one more, and it is 64."""

Message = dict[str, Any]


class Loss(NamedTuple):
    """Why a connection is over. kind: one of those below. code: of the protocol, or the status of the upgrade; or 0."""

    kind: str
    detail: str
    code: int = 0

    @property
    def is_final(self) -> bool:
        """Whether another connection would end in the same way."""
        return self.code in FINAL or self.kind in (DISORDERED, MALFORMED)


REFUSED: Final = "refused"
ENDED: Final = "ended"
DISORDERED: Final = "disordered"
MALFORMED: Final = "malformed"


class Peer(asyncio.Protocol):
    """One connection.

    known: the revision up to which everything is known; None before `welcome`. epoch: of its world.
    received: bytes.
    heard: called with each message and the moment it came. lost: called once, when the connection is over and `close`
        was not called.
    """

    def __init__(
        self,
        address: bytes,
        client: str,
        heard: Callable[["Peer", Message, float], None],
        lost: Callable[["Peer", Loss], None],
        *,
        regions: Sequence[Mapping[str, Any]],
        epoch: str | None = None,
        known: int | None = None,
    ) -> None:
        """address: what `upgrade` returns. regions: where to look. epoch, known: to go on from."""
        self.client = client
        self.known, self.epoch = known, epoch
        self.received = 0
        self._address, self._heard, self._lost, self._regions = address, heard, lost, regions
        self._unread = bytearray()
        self._is_open = self._is_over = False
        self._transport: asyncio.Transport | None = None

    def send(self, kind: str, **members: Any) -> None:
        """Send a message."""
        self._write(TEXT, json.dumps({"type": kind, **members}, separators=(",", ":")).encode())

    def close(self) -> None:
        """End the connection at once; nobody is told."""
        self._is_over = True
        if self._transport is not None:
            self._transport.abort()

    def pause(self) -> None:
        """Read nothing more."""
        if self._transport is not None:
            self._transport.pause_reading()

    def resume(self) -> None:
        """Read again."""
        if self._transport is not None and not self._is_over:
            self._transport.resume_reading()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.write(self._address)
        if self._is_over:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        moment = time.perf_counter()
        self.received += len(data)
        self._unread += data
        if not self._is_open and not self._opened():
            return
        while not self._is_over and (frame := self._next()) is not None:
            self._take(*frame, moment)

    def connection_lost(self, error: Exception | None) -> None:
        self._end(Loss(ENDED, f"closed {error or ''}".strip()))

    def _opened(self) -> bool:
        """Read the answer to the upgrade, if all of it is there, and introduce the peer."""
        end = self._unread.find(b"\r\n\r\n")
        if end < 0:
            if len(self._unread) > HEAD_BYTES_MAX:
                self._end(Loss(MALFORMED, f"{len(self._unread)} bytes without the end of a head"))
            return False
        if not self._unread.startswith(b"HTTP/1.1 101 "):
            line = self._unread[: min(self._unread.find(b"\r\n"), LINE_MAX)].decode("latin-1")
            self._end(Loss(REFUSED, line, int(line[9:12]) if line[9:12].isdigit() else 0))
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
            self._end(Loss(MALFORMED, f"a frame of {length} bytes"))
            return None
        if len(unread) < start + length:
            return None
        found = unread[0], bytes(unread[start : start + length])
        del unread[: start + length]
        return found

    def _take(self, first: int, payload: bytes, moment: float) -> None:
        if first == TEXT:
            self._hear(payload, moment)
        elif first == PING:
            self._write(PONG, payload)
        elif first == CLOSE:
            code = int.from_bytes(payload[:2], "big")
            self._end(Loss(ENDED, f"{code} {payload[2:].decode(errors='replace')}".strip(), code))
        else:
            self._end(Loss(MALFORMED, f"a frame that begins with {first:#x}"))

    def _hear(self, payload: bytes, moment: float) -> None:
        try:
            message = read_once(payload)
            self._learn(message)
        except (ValueError, LookupError, TypeError) as error:
            self._end(Loss(MALFORMED, f"{payload[:LINE_MAX].decode(errors='replace')}: {error!r}"))
            return
        if not self._is_over:
            self._heard(self, message, moment)

    def _learn(self, message: Message) -> None:
        """Move on what is known. A message that does not lead on from there ends the connection."""
        kind = message["type"]
        if kind == "welcome":
            if self.known is None:
                self.known, self.epoch = int(message["revision"]), message["epoch"]
            elif self.epoch != message["epoch"]:
                self._end(Loss(DISORDERED, f"the world of {self.epoch} has the epoch {message['epoch']}"))
        elif kind in ("edits", "progress", "stale", "resync"):
            revision = int(message["revision"])
            if self.known is None:
                self._end(Loss(DISORDERED, f"{kind} before the welcome"))
            elif revision < self.known or (kind == "edits" and int(message["after"]) != self.known):
                told = f"{kind} from {message.get('after')} to {revision}, where {self.known} is known"
                self._end(Loss(DISORDERED, told))
            elif kind == "edits" and not message["is_in_order"]:
                told = f"edits {message['revisions']} from {self.known} to {revision}"
                self._end(Loss(DISORDERED, told[:LINE_MAX]))
            self.known = revision

    def _write(self, first: int, payload: bytes) -> None:
        """Send a frame; with a mask of zeros, which changes nothing."""
        length = len(payload)
        size = bytes([0x80 | length]) if length < LONG else struct.pack(">BH", 0x80 | LONG, length)
        assert self._transport is not None
        self._transport.write(bytes([first]) + size + bytes(4) + payload)

    def _end(self, why: Loss) -> None:
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
    """Return the message of a frame. It is shared, and not to be changed.

    Of `edits` it has beside what was sent `revisions`, those of its edits, and whether it `is_in_order`: they rise, and
    lie in what the message spans. Raises ValueError, LookupError or TypeError if it lacks what each of its type has.
    """
    found: Message = json.loads(payload)
    if found["type"] == "ack":
        _ = int(found["revision"]), found["seq"], found["duplicate"], found["stale"]
    elif found["type"] == "nack":
        _ = int(found["problem"]["status"]), found["seq"], found["problem"]["type"]
    elif found["type"] == "welcome":
        _ = int(found["revision"]), found["last_seq"], int(found["limits"]["inflight"])
    elif found["type"] == "edits":
        revisions = tuple(int(edit["revision"]) for edit in found["edits"])
        places = (int(found["after"]), *revisions, int(found["revision"]) + 1)
        found["revisions"] = revisions
        found["is_in_order"] = all(before < after for before, after in itertools.pairwise(places))
    return found
