"""The bytes of a batch: chunks in the order in which they got ready, a frame each. docs/wire/batch-v1.md is the page.

stream header | frame | frame | ... | end
                 |
                 frame header, body, padding
"""

import struct
from http import HTTPStatus
from typing import Final

from chunkserver.wire import CODINGS

MAGIC: Final = b"CHNB"
VERSION: Final = 1
ALIGNMENT: Final = 16
"""Of every frame, in bytes from the start: what lies in a body aligned stays aligned."""
END: Final = 0xFFFFFFFF
"""The index of the last frame, which says that nothing is missing."""
CONTENTS: Final = ("", "air", "rock", "surface")
"""By their numbers in a frame."""

_STREAM: Final = struct.Struct("<4sHHQ")
_FRAME: Final = struct.Struct("<IIHBBIQ32s8x")
_CONTENT_NUMBERS: Final = {name: number for number, name in enumerate(CONTENTS)}
_CODING_NUMBERS: Final = {name: number for number, name in enumerate(CODINGS)}
_PADDING: Final = bytes(ALIGNMENT)

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
) -> tuple[bytes, bytes, bytes]:
    """Return the frame of the chunk that the request names at `index`, in parts: as a request for it alone is answered.

    content: of the chunk, if there is one. coding: of the body. tag: its entity tag, without quotes.
    """
    numbers = _CONTENT_NUMBERS[content], _CODING_NUMBERS[coding]
    header = _FRAME.pack(len(body), index, status, *numbers, 0, revision, tag.encode())
    return header, body, _PADDING[: -len(body) % ALIGNMENT]


def end(count: int) -> bytes:
    """Return the last frame of a batch that has `count` others."""
    return _FRAME.pack(0, END, HTTPStatus.OK, 0, 0, count, 0, b"")
