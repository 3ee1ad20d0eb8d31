"""A server that answers at once, always with the same bytes: what a load costs when the server costs nothing.

`python -m chunkserver_loadtest.instant BYTES` listens on a free port of loopback, says which in a line, and ends with
its standard input.
"""

import asyncio
import sys
from typing import Final, cast

from chunkserver_loadtest.event_loop import new_event_loop

BODY_BYTES_MAX: Final = 1 << 24
END: Final = b"\r\n\r\n"
HEAD: Final = (
    b"HTTP/1.1 200 OK\r\ndate: Thu, 01 Jan 1970 00:00:00 GMT\r\n"
    b'etag: "0123456789abcdef0123456789abcdef"\r\nvary: Accept, Accept-Encoding\r\ncache-control: no-cache\r\n'
    b"chunk-content: surface\r\ncontent-type: application/vnd.chunkserver.mesh\r\n"
    b"access-control-allow-origin: *\r\naccess-control-expose-headers: *\r\ncontent-length: %d\r\n\r\n"
)
"""As many header fields as a chunk has."""


class Instant(asyncio.Protocol):
    """Answers as many requests as there are ends of heads."""

    def __init__(self, answer: bytes) -> None:
        self._answer = answer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its bases

    def data_received(self, data: bytes) -> None:
        self._transport.write(self._answer * data.count(END))


async def answer_at_once(body_bytes: int) -> None:
    """Listen, say where, and answer until the standard input ends."""
    loop, answer = asyncio.get_running_loop(), HEAD % body_bytes + bytes(body_bytes)
    server = await loop.create_server(lambda: Instant(answer), "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await loop.run_in_executor(None, sys.stdin.read)
    server.close()


if __name__ == "__main__":
    wanted = int(sys.argv[1])
    if not 0 <= wanted <= BODY_BYTES_MAX:
        sys.exit(f"{wanted} bytes: 0 to {BODY_BYTES_MAX}")
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(answer_at_once(wanted))
