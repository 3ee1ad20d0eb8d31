"""The bytes of a batch: chunks in the order in which they got ready, a frame each. docs/wire/batch-v1.md is the page.

stream header | frame | frame | ... | end
                 |
                 frame header, body, padding
"""

import struct
from http import HTTPStatus
from typing import Final

from chunkserver.pipeline import Chunk
from chunkserver.wire import CODINGS

MAGIC: Final = b"CHNB"
VERSION: Final = 1
ALIGNMENT: Final = 16
"""Of every frame, in bytes from the start: what lies in a body aligned stays aligned."""
END: Final = 0xFFFFFFFF
"""The index of the last frame, which says that nothing is missing."""
CONTENTS: Final = ("", "air", "rock", "surface")

_STREAM: Final = struct.Struct("<4sHHQ")
_FRAME: Final = struct.Struct("<IIHBBIQ32s8x")
_CODING_NUMBERS: Final = {name: number for number, name in enumerate(CODINGS)}

assert _STREAM.size == ALIGNMENT
assert _FRAME.size % ALIGNMENT == 0


def stream_header(world_revision: int) -> bytes:
    """Return what a batch begins with."""
    return _STREAM.pack(MAGIC, VERSION, _FRAME.size, world_revision)


def frame(
    index: int,
    status: int,
    *,
    body: bytes = b"",
    content: str = "",
    coding: str = "identity",
    revision: int = 0,
    tag: str = "",
) -> bytes:
    """Return the frame of the chunk that the request names at `index`: as a request for it alone is answered.

    coding: of the body. tag: its entity tag, without quotes.
    """
    padding = bytes(-len(body) % ALIGNMENT)
    numbers = CONTENTS.index(content), _CODING_NUMBERS[coding]
    return b"".join((_FRAME.pack(len(body), index, status, *numbers, 0, revision, tag.encode()), body, padding))


def chunk_frame(index: int, chunk: Chunk, status: HTTPStatus, *, coding: str, revision: int, tag: str) -> bytes:
    """Return the frame of `chunk`: with its body, or for a 204 without."""
    if status == HTTPStatus.NO_CONTENT:
        return frame(index, status, content=chunk.content, revision=revision, tag=tag)
    return frame(index, status, body=chunk.body, content=chunk.content, coding=coding, revision=revision, tag=tag)


def end(count: int) -> bytes:
    """Return the last frame of a batch that has `count` others."""
    return _FRAME.pack(0, END, HTTPStatus.OK, 0, 0, count, 0, b"")
