"""One HTTP server until SIGTERM or SIGINT: requests in flight are answered, then the process ends with exit code 0."""

import logging
import signal
import socket
import sys
from types import FrameType
from typing import Final, NoReturn

import uvicorn
from fastapi import FastAPI

from chunkserver import __version__
from chunkserver.server.settings import Settings

BACKLOG_MAX: Final = 1024
"""Connections that the operating system accepts before the server does."""
CONNECTIONS_MAX: Final = 1024
"""Connections, or requests in flight, beyond which new requests get a bare 503 from the HTTP server itself."""
KEEP_ALIVE_SECONDS: Final = 15
GRACE_SECONDS: Final = 30
"""How long a stop waits for requests in flight."""
LOG_FORMAT: Final = "%(asctime)s %(levelname)s %(name)s: %(message)s"

logger: Final = logging.getLogger("chunkserver")


def serve(app: FastAPI, settings: Settings) -> None:
    """Serve `app` until a signal. Raises OSError if the address cannot be had."""
    logging.basicConfig(level=logging.INFO, format=LOG_FORMAT, stream=sys.stderr)
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # its warnings are about clients: anybody could fill the log
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    with listen(settings.host, settings.port) as listening:
        logger.info("version %s on %s; kernels are compiled first, once per version", __version__, url_of(listening))
        uvicorn.Server(_config(app)).run(sockets=[listening])


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to `host` and `port`. Raises OSError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family, backlog=BACKLOG_MAX)


def url_of(listening: socket.socket) -> str:
    """Return the URL of a bound socket."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _config(app: FastAPI) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        access_log=False,
        backlog=BACKLOG_MAX,
        limit_concurrency=CONNECTIONS_MAX,
        log_config=None,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_SECONDS,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        ws="none",
    )


def _stop(_number: int, _frame: FrameType | None) -> NoReturn:
    """End at once: the server has not begun, or has stopped. While it runs it takes signals, then sends them again."""
    sys.exit(0)
