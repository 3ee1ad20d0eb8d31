"""A pool without processes: it counts, answers at once, and fails when told to."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from fastapi.testclient import TestClient

from chunkserver.edits import Bricks
from chunkserver.grid import LOD_MAX
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe
from chunkserver.server import Settings, create_app
from chunkserver.server.app import Application
from chunkserver.server.service import Builder

SURFACE = Chunk("surface", b"a mesh")
SLOTS = 2048


class StubPool:
    """Answers every request with `chunk`, or raises `error`; `built` are the requests so far."""

    def __init__(self, chunk: Chunk = SURFACE, error: Exception | None = None, ready: bool = True) -> None:
        self.chunk = chunk
        self.error = error
        self.ready = ready
        self.full = False
        self.arena = np.zeros(SLOTS * 4096, np.int32)
        self.bricks: list[Bricks | None] = []
        self.built: list[ChunkRequest] = []
        self.ranks: list[tuple[int, float]] = []
        self.life: list[str] = []

    async def start(self) -> None:
        self.life.append("start")

    async def close(self) -> None:
        self.life.append("close")

    def refuses(self, _urgency: int, _lod: int) -> bool:
        return self.full

    async def build(
        self,
        request: ChunkRequest,
        begun: Callable[[], None],
        *,
        urgency: int = 3,
        distance: float = 0.0,
        bricks: Bricks | None = None,
    ) -> Chunk:
        begun()
        self.bricks.append(bricks)
        self.built.append(request)
        self.ranks.append((urgency, distance))
        if self.error is not None:
            raise self.error
        return self.chunk


class StubErrors:
    """Knows the error of each level of every recipe: half a step."""

    async def find(self, _recipe: WorldRecipe) -> tuple[float, ...]:
        return tuple(0.5 * 2**lod for lod in range(LOD_MAX + 1))


def app_of(settings: Settings, pool: Builder) -> Application:
    """The application over `pool`, which nobody asks for errors of levels."""
    app = create_app(settings, pool)
    app.state.service = replace(app.state.service, errors=StubErrors())
    return app


@contextmanager
def client_of(pool: StubPool, folder: Path | None = None) -> Iterator[TestClient]:
    """A client of the application over `pool`, its lifespan included; with its worlds in `folder`."""
    app = app_of(Settings(workers=1, data=folder), pool)
    plain = {"Accept-Encoding": "identity"}  # what the pool answers is coded by nobody
    with TestClient(app, raise_server_exceptions=False, follow_redirects=False, headers=plain) as client:
        yield client
