"""One HTTP server until SIGTERM or SIGINT: requests in flight are answered, then the process ends with exit code 0."""

import asyncio
import gc
import logging
import math
import resource
import signal
import socket
import sys
from types import FrameType
from typing import Final, NoReturn

import uvicorn
from starlette.types import ASGIApp

from chunkserver import __version__
from chunkserver.server import log_format
from chunkserver.server.connections import ConnectionLimits, Connections
from chunkserver.server.protocol import bounded
from chunkserver.server.stream_protocol import MESSAGE_BYTES_MAX, streaming
from chunkserver.stream import limits as stream_limits

BACKLOG_MAX: Final = 1024
"""Connections that the operating system accepts before the server does."""
DESCRIPTORS_BESIDE: Final = 1024
"""File descriptors that are needed besides those of connections: workers, worlds, the cache on disk."""
GRACE_SECONDS: Final = 30
"""How long a stop waits for requests in flight."""

GC_THRESHOLDS: Final = (10_000, 20, 50)
"""Seldom: what is in no circle goes at once. With Python's own, a full collection of all bricks, 20 to 40 ms of them,
comes every few seconds while players edit."""

logger: Final = logging.getLogger("chunkserver")


def serve(app: ASGIApp, listening: socket.socket, connections: Connections | None = None) -> None:
    """Serve `app` on a socket that `listen` made, until a signal; then close it.

    connections: their limits, and where they are counted; by default those of `ConnectionLimits`.
    """
    bounds = Connections() if connections is None else connections
    if not logging.getLogger().handlers:
        log_format.install("text", "info")
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # its warnings are about clients: anybody could fill the log
    logging.getLogger("uvicorn.error").addFilter(_is_news)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    with listening:
        logger.info("version %s on %s; kernels are compiled first, once per version", __version__, url_of(listening))
        _make_room(listening, bounds.limits)
        gc.collect()
        gc.freeze()  # else a full collection walks all that is imported: 30 ms in the middle of a request
        gc.set_threshold(*GC_THRESHOLDS)
        uvicorn.Server(_config(app, bounds)).run(sockets=[listening])


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to `host` and `port`. Raises OSError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family, backlog=BACKLOG_MAX)


def url_of(listening: socket.socket) -> str:
    """Return the URL of a bound socket."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _is_news(record: logging.LogRecord) -> bool:
    """Whether uvicorn says more than that a request was cancelled: one line counts all that a stop has cancelled."""
    return record.exc_info is None or not isinstance(record.exc_info[1], asyncio.CancelledError)


def _make_room(listening: socket.socket, limits: ConnectionLimits) -> None:
    """Let the operating system give up clients that are gone, and allow as many file descriptors as may be needed."""
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # each connection takes it over
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(limits.send_seconds * 1000))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = limits.connections_max + DESCRIPTORS_BESIDE
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    allowed = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    if allowed < wanted:
        logger.info(
            "%d file descriptors for up to %d connections: %d are wanted", allowed, limits.connections_max, wanted
        )


def _config(app: ASGIApp, connections: Connections) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        access_log=False,
        backlog=BACKLOG_MAX,
        http=bounded(connections),
        log_config=None,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_SECONDS,
        timeout_keep_alive=math.ceil(connections.limits.keep_alive_seconds),
        ws=streaming(connections),
        ws_max_size=MESSAGE_BYTES_MAX,
        ws_per_message_deflate=False,
        ws_ping_interval=stream_limits.PING_SECONDS,
        ws_ping_timeout=stream_limits.PONG_SECONDS,
    )


def _stop(_number: int, _frame: FrameType | None) -> NoReturn:
    """End at once: the server has not begun, or has stopped. While it runs it takes signals, then sends them again."""
    sys.exit(0)
