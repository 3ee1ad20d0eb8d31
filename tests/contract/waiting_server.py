"""A server whose builds wait until a file appears: for tests of what a stop does to requests in flight.

Run as `python -m tests.contract.waiting_server FILE [SECONDS [LIMITS]]`: a stop waits that long for them, and LIMITS
are some of `ConnectionLimits`, in JSON; `header_seconds` is for bodies, too.
"""

import asyncio
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from chunkserver.memory import NO_ARENA
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.server import Settings, body, create_app, listen, run, serve
from chunkserver.server.connections import ConnectionLimits, Connections
from chunkserver.wire import CODINGS


class WaitingPool:
    """Builds one kind of chunk, when `released` exists. The seed -1 fails."""

    ready = True
    arena = NO_ARENA

    def __init__(self, released: Path) -> None:
        self.released = released

    async def start(self) -> None: ...

    async def close(self) -> None:
        logging.getLogger("tests").info("closed")

    def refuses(self, _urgency: int, _lod: int) -> bool:
        return False

    async def build(self, request: ChunkRequest, begun: Callable[[], None], **_rest: Any) -> Chunk:
        begun()
        if request.recipe.seed == -1:
            raise ValueError("a fault of the server")
        logging.getLogger("tests").info("building")
        while not self.released.exists():
            await asyncio.sleep(0.01)
        return Chunk("surface", CODINGS[request.encoding.coding].apply(b"built"))


if __name__ == "__main__":
    settings = Settings(port=0, workers=1)
    app = create_app(settings, WaitingPool(Path(sys.argv[1])))
    limits = ConnectionLimits(**json.loads(sys.argv[3] if sys.argv[3:] else "{}"))
    grace_seconds = int(sys.argv[2]) if sys.argv[2:] else run.GRACE_SECONDS
    with (
        mock.patch.object(run, "GRACE_SECONDS", grace_seconds),
        mock.patch.object(body, "BODY_SECONDS_MAX", limits.header_seconds),
    ):
        serve(app, listen(settings.host, settings.port), Connections(limits))
