"""Edits that are sent in the plain form are answered without the framework, which takes longer than a small edit does.

    POST /v1/worlds/{world}/edits, no query, no header field twice, a key that may be one    -> answered here
    everything else                                                                          -> the framework

What is refused here is refused as the framework would: the same errors, and the same table of problems.
"""

import re
from typing import Final

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from chunkserver.errors import ChunkError
from chunkserver.server.edits import EDITS, KEY_PATTERN, append, router
from chunkserver.server.problems import refusal
from chunkserver.server.service import Service
from chunkserver.world import ID_PATTERN

KEY_FIELD: Final = b"idempotency-key"

_PATH: Final = re.compile(EDITS.replace("{world}", f"({ID_PATTERN.strip('^$')})"), re.ASCII)
_KEY: Final = re.compile(KEY_PATTERN.strip("^$").encode())
_ROUTE: Final = next(route for route in router.routes if getattr(route, "path", "") == EDITS)


class PlainEdits:
    """ASGI: answers plain posts of edits, and hands on everything else."""

    def __init__(self, app: ASGIApp, service: Service) -> None:
        self._app = app
        self._service = service

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or let the framework do it."""
        plain = _plain(scope)
        if plain is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = _ROUTE  # under which it is counted
        request = Request(scope, receive)
        try:
            response = await append(self._service, request, *plain)
        except ChunkError as error:
            response = refusal(request, error)
        await response(scope, receive, send)


def _plain(scope: Scope) -> tuple[str, str | None] | None:
    """Return the world and the key of a plain post of an edit; None for any other request."""
    if scope["type"] != "http" or scope["method"] != "POST" or scope["query_string"]:
        return None
    path, fields = _PATH.fullmatch(scope["path"]), dict(scope["headers"])
    if path is None or len(fields) != len(scope["headers"]):
        return None
    key = fields.get(KEY_FIELD)
    if key is None:
        return path[1], None
    return (path[1], key.decode()) if _KEY.fullmatch(key) else None
