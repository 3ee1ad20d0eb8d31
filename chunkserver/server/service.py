"""What every route shares: the workers, the cache, the posted recipes and the worlds, found on the application."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np
from fastapi import Depends, Request
from numpy.typing import NDArray

from chunkserver.edits import Bricks
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.server.answers import Answers
from chunkserver.server.body import Bodies
from chunkserver.server.cache import ChunkCache
from chunkserver.server.connections import Connections
from chunkserver.server.cors import Cors
from chunkserver.server.geometric_errors import GeometricErrors
from chunkserver.server.pool import URGENCY_DEFAULT
from chunkserver.server.posted import PostedRecipes
from chunkserver.server.request_counts import RequestCounts
from chunkserver.server.store import WorldStore
from chunkserver.server.streams import Streams
from chunkserver.server.tickets import Tickets


class Builder(Protocol):
    """Who builds chunks: `Pool`, or a stand-in of a test."""

    @property
    def arena(self) -> NDArray[np.int32]:
        """Memory for bricks."""

    @property
    def ready(self) -> bool:
        """Whether a chunk can be built at once, without compiling first."""

    async def start(self) -> None:
        """Begin to get ready; returns at once."""

    def refuses(self, urgency: int, lod: int) -> bool:
        """Whether `build` would raise `Overloaded` now, for a request of that urgency and LOD. Cheap."""

    def build(
        self,
        request: ChunkRequest,
        begun: Callable[[], None],
        *,
        urgency: int = URGENCY_DEFAULT,
        distance: float = 0.0,
        bricks: Bricks | None = None,
    ) -> Awaitable[Chunk]:
        """Build one chunk; raises `ChunkError`. Calls `begun` when it is no longer only waiting.

        urgency: 0 (most) to 7. distance: in chunk lengths, from who looks at it. bricks: see `Pool.build`.
        """

    async def close(self) -> None:
        """End every worker process."""


@dataclass(frozen=True, slots=True)
class Service:
    """Workers, the chunks that they made, answers given before, posted recipes, worlds, errors of levels,
    streams of edits; which pages may do what, tickets, connections, large bodies and counts.
    """

    pool: Builder
    cache: ChunkCache
    answers: Answers
    posted: PostedRecipes
    worlds: WorldStore
    errors: GeometricErrors
    streams: Streams
    cors: Cors
    tickets: Tickets = field(default_factory=Tickets)
    connections: Connections = field(default_factory=Connections)
    bodies: Bodies = field(default_factory=Bodies)
    requests: RequestCounts = field(default_factory=RequestCounts)


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


ServiceOfApp = Annotated[Service, Depends(_service)]
"""A route's parameter of this type receives the application's `Service`."""
