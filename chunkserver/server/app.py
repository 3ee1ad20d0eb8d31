"""The application: every route, every error, and the workers' life, put together."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from operator import attrgetter

from fastapi import FastAPI

from chunkserver import __version__
from chunkserver.server import chunks, health, landing, openapi, problems, recipes, seeds
from chunkserver.server.cache import ChunkCache
from chunkserver.server.pool import Pool
from chunkserver.server.posted import PostedRecipes
from chunkserver.server.service import Builder, Service
from chunkserver.server.settings import Settings

DESCRIPTION = "Marching-cubes terrain: a seed and a coordinate in, a mesh out. Positions are in voxels, y is up."


def create_app(settings: Settings, pool: Builder | None = None) -> FastAPI:
    """Return the application. Its lifespan starts and closes `pool`, by default `settings.workers` processes."""
    app = FastAPI(
        title="chunkserver",
        version=__version__,
        description=DESCRIPTION,
        redoc_url=None,
        swagger_ui_oauth2_redirect_url=None,
        redirect_slashes=False,
        generate_unique_id_function=attrgetter("name"),
        lifespan=_lifespan,
    )
    app.state.service = Service(pool or Pool(settings.workers), ChunkCache(settings.cache_bytes), PostedRecipes())
    for room in (landing, health, recipes, seeds, chunks):
        app.include_router(room.router)
    problems.install(app)
    openapi.install(app)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    service: Service = app.state.service
    await service.pool.start()
    try:
        yield
    finally:
        await service.pool.close()
