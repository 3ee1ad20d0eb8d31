"""Content codings of the frames of a batch. Those of whole answers are httpx2's to undo."""

import sys
import zlib
from typing import Final, Literal

from chunkserver_client.errors import BadChunk

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Coding = Literal["identity", "gzip", "zstd"]
CODINGS: Final[tuple[Coding, ...]] = ("identity", "gzip", "zstd")
"""In the order of their numbers in a frame."""

GZIP_WINDOW_BITS: Final = 31


def decoded(body: bytes, coding: Coding, bytes_max: int) -> bytes:
    """Return `body` without its coding. Raises `BadChunk` if it is broken, cut, or longer than `bytes_max`."""
    if coding == "identity":
        return body
    try:
        if coding == "gzip":
            gzip = zlib.decompressobj(GZIP_WINDOW_BITS)
            content, is_whole = gzip.decompress(body, bytes_max), gzip.eof and not gzip.unused_data
        else:
            frame = zstd.ZstdDecompressor()
            content, is_whole = frame.decompress(body, bytes_max), frame.eof and not frame.unused_data
    except (zlib.error, zstd.ZstdError, EOFError) as error:
        raise BadChunk(f"{coding}: {error}") from None
    if not is_whole:
        raise BadChunk(f"{coding}: cut, or longer than {bytes_max} bytes, or more than one")
    return content
