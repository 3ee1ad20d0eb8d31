"""The only package that knows HTTP, asyncio and FastAPI."""

from chunkserver.server.app import create_app
from chunkserver.server.run import listen, serve
from chunkserver.server.settings import WORKERS_MAX, Settings

__all__ = ["WORKERS_MAX", "Settings", "create_app", "listen", "serve"]
