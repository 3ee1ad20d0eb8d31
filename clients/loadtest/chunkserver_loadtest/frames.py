"""The frames of a batch's stream: docs/wire/batch-v1.md."""

import struct
from collections.abc import Iterator
from typing import Final, NamedTuple

MAGIC: Final = b"CHNB"
VERSION: Final = 1
STREAM_HEADER: Final = struct.Struct("<4sHHQ")
FRAME_HEADER: Final = struct.Struct("<IIHBBIQ32s")
END: Final = 0xFFFFFFFF
ALIGNMENT: Final = 16
FRAME_HEADER_BYTES_MAX: Final = 4096
CONTENTS: Final = ("", "air", "rock", "surface")
CODINGS: Final = ("", "gzip", "zstd")


class Frame(NamedTuple):
    """One chunk of a batch.

    number: which of those that were asked for. content, coding, etag: empty if not told.
    ends: bytes of the stream up to its end.
    """

    number: int
    status: int
    content: str
    coding: str
    revision: int
    etag: str
    body: bytes
    ends: int


class BadFrames(ValueError):
    """The stream is not as the document says, or was cut."""


def frames(stream: bytes) -> Iterator[Frame]:
    """Yield all frames but the last, which ends the stream. Raises BadFrames, which names the place."""
    if len(stream) < STREAM_HEADER.size:
        raise BadFrames(f"{len(stream)} bytes are no stream")
    magic, version, header_bytes, _ = STREAM_HEADER.unpack_from(stream)
    if (magic, version) != (MAGIC, VERSION) or not FRAME_HEADER.size <= header_bytes <= FRAME_HEADER_BYTES_MAX:
        raise BadFrames(f"the stream begins with {magic!r}, version {version}, frame headers of {header_bytes} bytes")
    at, count = STREAM_HEADER.size, 0
    while at + header_bytes <= len(stream):
        body_bytes, number, status, content, coding, told, revision, etag = FRAME_HEADER.unpack_from(stream, at)
        body_at = at + header_bytes
        ends = body_at + -(-body_bytes // ALIGNMENT) * ALIGNMENT
        if number == END:
            _check_end(stream, ends, told, count)
            return
        if ends > len(stream) or content >= len(CONTENTS) or coding >= len(CODINGS):
            raise BadFrames(f"frame {count}, at {at}: {body_bytes} bytes, content {content}, coding {coding}")
        tag = f'"{etag.decode("latin-1")}"' if etag.strip(b"\0") else ""
        body = stream[body_at : body_at + body_bytes]
        yield Frame(number, status, CONTENTS[content], CODINGS[coding], revision, tag, body, ends)
        at, count = ends, count + 1
    raise BadFrames(f"{len(stream)} bytes without an end frame")


def _check_end(stream: bytes, ends: int, told: int, count: int) -> None:
    if told != count:
        raise BadFrames(f"the end frame speaks of {told} frames: {count} came")
    if ends != len(stream):
        raise BadFrames(f"{len(stream) - ends} bytes follow the end frame")
