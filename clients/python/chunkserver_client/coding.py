"""Content codings, of answers and of the frames of a batch.

httpx2 could undo those of answers, but not by the clock: it returns when it has decoded something, and a coded body
that comes byte by byte gives nothing for a long time. Nor does it say that a gzip body is cut.
"""

import sys
import zlib
from typing import Final, Literal

from chunkserver_client.errors import BadAnswer

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Coding = Literal["identity", "gzip", "zstd"]
CODINGS: Final[tuple[Coding, ...]] = ("identity", "gzip", "zstd")
"""In the order of their numbers in a frame."""

GZIP_WINDOW_BITS: Final = 31


def decoded(body: bytes, coding: str, bytes_max: int) -> bytes:
    """Return `body` without its coding. Raises `BadAnswer` if that is unknown, broken, cut, or too long."""
    if coding == "identity":
        return body
    try:
        if coding == "gzip":
            gzip = zlib.decompressobj(GZIP_WINDOW_BITS)
            content, is_whole = gzip.decompress(body, bytes_max), gzip.eof and not gzip.unused_data
        elif coding == "zstd":
            frame = zstd.ZstdDecompressor()
            content, is_whole = frame.decompress(body, bytes_max), frame.eof and not frame.unused_data
        else:
            raise BadAnswer(f"the content coding is {coding!r}: there are {CODINGS}")
    except (zlib.error, zstd.ZstdError, EOFError) as error:
        raise BadAnswer(f"{coding}: {error}") from None
    if not is_whole:
        raise BadAnswer(f"{coding}: cut, or longer than {bytes_max} bytes, or more than one")
    return content
