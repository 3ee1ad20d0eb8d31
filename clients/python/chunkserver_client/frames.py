"""The batch stream, version 1, from bytes as they come to frames: docs/wire/batch-v1.md."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from chunkserver_client.coding import CODINGS, Coding
from chunkserver_client.errors import BadAnswer
from chunkserver_client.mesh import CONTENTS, REVISION_MAX, Content

MEDIA_TYPE: Final = "application/vnd.chunkserver.batch"
MAGIC: Final = b"CHNB"
VERSION: Final = 1
FRAME_HEADER_BYTES_MIN: Final = 64
FRAME_HEADER_BYTES_MAX: Final = 1 << 10
END: Final = 0xFFFFFFFF
ALIGNMENT: Final = 16

_STREAM: Final = struct.Struct("<4s2HQ")
_FRAME: Final = struct.Struct("<2IH2BIQ32sQ")
assert (_STREAM.size, _FRAME.size) == (16, FRAME_HEADER_BYTES_MIN)


@dataclass(frozen=True, slots=True)
class Frame:
    """One chunk of a batch.

    index: which of the request's chunks.
    status: what a request for it alone would have had.
    content: None if it is not told.
    coding: of `body`.
    revision: of the chunk's own last edit.
    tag: without quotes; "" if there is none.
    """

    index: int
    status: int
    content: Content | None
    coding: Coding
    revision: int
    tag: str
    body: bytes


class FrameReader:
    """Takes the stream in pieces of any size and gives its frames. After the end frame, `is_done` is true.

    bytes_max: of the body of a frame. Raises `BadAnswer` for a stream that is none; at most one frame is held.
    """

    def __init__(self, bytes_max: int) -> None:
        self._bytes_max = bytes_max
        self._held = bytearray()
        self._frame_header_bytes = 0
        self._count = 0
        self.is_done = False

    def feed(self, piece: bytes) -> Iterator[Frame]:
        """Yield the frames that `piece` completes."""
        self._held += piece
        if not self._frame_header_bytes and len(self._held) >= _STREAM.size:
            self._read_stream_header()
        while self._frame_header_bytes and not self.is_done:
            frame = self._next()
            if frame is None:
                return
            yield frame

    def _read_stream_header(self) -> None:
        magic, version, frame_header_bytes, _ = _STREAM.unpack_from(self._held)
        if (magic, version) != (MAGIC, VERSION):
            raise BadAnswer(f"a batch begins with {magic!r} {version}: expected {MAGIC!r} {VERSION}")
        if frame_header_bytes % ALIGNMENT or not FRAME_HEADER_BYTES_MIN <= frame_header_bytes <= FRAME_HEADER_BYTES_MAX:
            raise BadAnswer(f"frame_header_bytes is {frame_header_bytes}")
        self._frame_header_bytes = frame_header_bytes
        del self._held[: _STREAM.size]

    def _next(self) -> Frame | None:
        """Return the next frame; None if it is not all there yet, or if the stream is done."""
        if len(self._held) < FRAME_HEADER_BYTES_MIN:
            return None
        body_bytes, index, status, content, coding, count, revision, tag, _ = _FRAME.unpack_from(self._held)
        if body_bytes > self._bytes_max:
            raise BadAnswer(f"a frame of {body_bytes} bytes: at most {self._bytes_max}")
        begin = self._frame_header_bytes
        end = begin + body_bytes + -body_bytes % ALIGNMENT
        if len(self._held) < end:
            return None
        body = bytes(memoryview(self._held)[begin : begin + body_bytes])
        del self._held[:end]
        if index == END:
            self._finish(count)
            return None
        if content > len(CONTENTS) or coding >= len(CODINGS) or revision > REVISION_MAX or not tag.isascii():
            raise BadAnswer(f"frame {index} has content {content}, coding {coding}, revision {revision}, tag {tag!r}")
        self._count += 1
        told = CONTENTS[content - 1] if content else None
        return Frame(index, status, told, CODINGS[coding], revision, tag.rstrip(b"\0").decode("ascii"), body)

    def _finish(self, count: int) -> None:
        if count != self._count or self._held:
            raise BadAnswer(f"the end frame counts {count} frames, {self._count} came; {len(self._held)} bytes follow")
        self.is_done = True
