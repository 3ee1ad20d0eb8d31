"""The application: every route, every error, and the workers' life, put together."""

import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from operator import attrgetter
from typing import Final

from fastapi import FastAPI
from starlette.types import ASGIApp, Receive, Send
from starlette.types import Scope as Asked

from chunkserver import __version__
from chunkserver.edits import Arena
from chunkserver.errors import ChunkError
from chunkserver.server import (
    batch,
    edits,
    health,
    landing,
    metrics,
    openapi,
    problems,
    recipes,
    seeds,
    stream,
    ticket,
    viewer,
    world_chunks,
    worlds,
)
from chunkserver.server.access import Access, check_exposure
from chunkserver.server.answers import Answers
from chunkserver.server.cache import ChunkCache
from chunkserver.server.connections import Connections
from chunkserver.server.cors import Cors, CorsLayer
from chunkserver.server.disk import DiskCache
from chunkserver.server.front import Front
from chunkserver.server.geometric_errors import GeometricErrors
from chunkserver.server.keys import Keyring, Scope
from chunkserver.server.plain_edits import PlainEdits
from chunkserver.server.pool import Pool
from chunkserver.server.posted import PostedRecipes
from chunkserver.server.request_log import RequestLog
from chunkserver.server.service import Builder, Service
from chunkserver.server.settings import Settings
from chunkserver.server.store import WorldStore
from chunkserver.server.streams import Streams
from chunkserver.store import Store

DESCRIPTION = "Marching-cubes terrain: a seed and a coordinate in, a mesh out. Positions are in voxels, y is up."

_log: Final = logging.getLogger(__name__)


class Application(FastAPI):
    """FastAPI behind layers that answer most requests without it."""

    front: ASGIApp

    async def __call__(self, scope: Asked, receive: Receive, send: Send) -> None:
        """Answer one request."""
        await self.front(scope, receive, send)

    async def routed(self, scope: Asked, receive: Receive, send: Send) -> None:
        """Answer one request by its route."""
        if scope["type"] != "lifespan" and scope["path"].endswith("\n"):
            scope = {**scope, "path": scope["path"] + "\n"}  # a route's pattern ends with `$`, which lets one pass
        await super().__call__(scope, receive, send)


def create_app(settings: Settings, pool: Builder | None = None) -> Application:
    """Return the application. Its lifespan starts and closes `pool`, by default `settings.workers` processes.

    It has `settings.data` from now on, until its lifespan ends. Raises `StoreError` if that cannot be had, and
    `BadSetting` if everybody could write.
    """
    check_exposure(settings.host, settings.api_keys, settings.insecure)
    app = Application(
        title="chunkserver",
        version=__version__,
        description=DESCRIPTION,
        redoc_url=None,
        swagger_ui_oauth2_redirect_url=None,
        redirect_slashes=False,
        generate_unique_id_function=attrgetter("name"),
        lifespan=_lifespan,
    )
    cors = Cors(settings.cors_origins)
    store = Store(settings.data)
    try:
        disk = DiskCache(settings.disk_cache, settings.disk_cache_bytes) if settings.disk_cache else None
    except ChunkError:
        store.close()
        raise
    cache = ChunkCache(settings.cache_bytes, disk)
    pool = pool or Pool(settings.workers, settings.pool_limits)
    arena = Arena(pool.arena, settings.edit_bytes)
    kept = WorldStore(store, settings.answer_seconds, arena, settings.log_edits)
    connections = Connections(settings.connection_limits)
    app.state.service = Service(
        pool,
        cache,
        Answers(cache, cors),
        PostedRecipes(),
        kept,
        GeometricErrors(pool),
        Streams(kept.edits, store, connections.shares),
        cors,
        connections=connections,
    )
    for room in (viewer, landing, health, metrics, recipes, worlds, edits, stream, ticket, world_chunks, seeds, batch):
        app.include_router(room.router)
    app.add_middleware(PlainEdits, service=app.state.service)
    problems.install(app)
    openapi.install(app)
    logged = RequestLog(CorsLayer(app.routed, cors), app.state.service.requests, settings.log_requests)
    app.front = Front(logged, app.state.service)
    if settings.api_keys:
        anonymous = Scope.READ if settings.anonymous_read else None
        service: Service = app.state.service
        keyring = Keyring(settings.api_keys)
        access = Access(app.front, keyring, anonymous, cors, counts=service.requests, tickets=service.tickets)
        access.describe(app.openapi())
        app.front = access
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    service: Service = app.state.service
    where = "on disk" if service.worlds.durable else "in memory, until the server ends; --data DIR keeps them"
    _log.info("%d worlds, %s", len(service.worlds), where)
    async with AsyncExitStack() as closing:  # each is closed, even if another cannot be
        for part in (service.worlds, service.cache, service.pool, service.streams):
            closing.push_async_callback(part.close)
        await service.pool.start()
        await service.worlds.start()
        yield
