"""The only package that knows HTTP, asyncio and FastAPI."""

from chunkserver.server.app import create_app
from chunkserver.server.flags import with_settings
from chunkserver.server.keys import mint
from chunkserver.server.run import listen, serve
from chunkserver.server.settings import Settings

__all__ = ["Settings", "create_app", "listen", "mint", "serve", "with_settings"]
