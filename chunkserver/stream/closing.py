"""Why a connection ends: the codes of docs/wire/edit_v1.md."""

from typing import Final, NamedTuple


class Close(NamedTuple):
    """A code of WebSocket, and words for who reads logs."""

    code: int
    reason: str


LEFT: Final = Close(1000, "the peer is gone")
GOING_AWAY: Final = Close(1001, "the server stops")
NO_FRAME: Final = Close(1002, "what came is no frame")
LOST: Final = Close(1006, "the connection broke")
"""Stands for no code at all: RFC 6455 has it, and nobody sends it."""
NOT_TEXT: Final = Close(1007, "the text is not UTF-8")
TOO_LARGE: Final = Close(1009, "the frame is too large")
FAILED: Final = Close(1011, "the server failed")
UNAUTHORISED: Final = Close(4401, "the key is not good any more")
GONE: Final = Close(4404, "the world is gone")
NO_HELLO: Final = Close(4408, "hello did not come in time")
TOO_SLOW: Final = Close(4408, "nothing was taken for too long")
REPLACED: Final = Close(4409, "the client has another connection")
MALFORMED: Final = 4400
OUT_OF_ORDER: Final = 4412

REASON_BYTES_MAX: Final = 123
"""What a close frame has room for."""


def malformed(reason: str) -> Close:
    """Return why a frame that is no message ends the connection."""
    return Close(MALFORMED, _cut(reason))


def out_of_order(reason: str) -> Close:
    """Return why a message that may not come now ends the connection."""
    return Close(OUT_OF_ORDER, _cut(reason))


def _cut(reason: str) -> str:
    return reason.encode("ascii", "replace")[:REASON_BYTES_MAX].decode()
