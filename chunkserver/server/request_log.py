"""Every request that gets this far: it has an id, it is counted, and, if it is worth it, it is a line of the log.

X-Request-Id, or a new one -> the application -> X-Request-Id of the answer, a count, maybe a line
                                   |
                                   +-> `request=` of all that is logged meanwhile, `instance` of a problem
"""

import logging
import re
import secrets
import time
from http import HTTPStatus
from itertools import count
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chunkserver.server.access import KEY_NAME
from chunkserver.server.chunks import CLIENT_LEFT
from chunkserver.server.log_format import FIELDS, request_id
from chunkserver.server.problems import REQUEST_ID
from chunkserver.server.request_counts import OTHER, RequestCounts

HEADER: Final = b"x-request-id"
ID_PATTERN: Final = "^[!-~]{1,128}$"
"""Visible ASCII. What a client sends that is anything else is replaced."""
PROBED: Final = "/readyz"
"""Asked all the time; that a server is not ready yet is an answer, and no failure."""
LINES_PER_SECOND_MAX: Final = 10
"""Of requests that failed, over a longer time: anybody can fail. Those that are our fault have as many of their own."""
LINES_AT_ONCE_MAX: Final = 100

_ID: Final = re.compile(ID_PATTERN.strip("^$").encode())
_log: Final = logging.getLogger("chunkserver.requests")


class Allowance:
    """How many lines may be written: LINES_AT_ONCE_MAX, and from then on LINES_PER_SECOND_MAX a second."""

    def __init__(self) -> None:
        self._left = float(LINES_AT_ONCE_MAX)
        self._then = time.monotonic()

    def take(self) -> bool:
        """Return whether one more may be written now."""
        now = time.monotonic()
        self._left = min(LINES_AT_ONCE_MAX, self._left + (now - self._then) * LINES_PER_SECOND_MAX)
        self._then = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class RequestLog:
    """ASGI: gives each request an id, counts it in `counts`, and logs it.

    which: "none", "problems" (answers of 400 and above, at a bounded rate, but not that it is not ready), or "all".
    """

    def __init__(self, app: ASGIApp, counts: RequestCounts, which: str) -> None:
        self._app = app
        self._counts = counts
        self._which = which
        start = secrets.token_hex(6)  # of this server's life. One for each request would be a system call for each
        self._made = (f"{start}-{number:x}" for number in count(1))
        self._theirs, self._ours = Allowance(), Allowance()
        self._left_out = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Have the application answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        name = self._id(scope)
        scope[REQUEST_ID] = name
        status = length = 0

        async def send_with_id(message: Message) -> None:
            nonlocal status, length
            if message["type"] == "http.response.start":
                status = message["status"]
                message = {**message, "headers": (*message["headers"], (HEADER, name.encode()))}
            else:
                length += len(message.get("body", b""))
            await send(message)

        began = time.perf_counter()
        token = request_id.set(name)
        self._counts.in_flight += 1
        try:
            await self._app(scope, receive, send_with_id)
            status = status or CLIENT_LEFT
        finally:
            self._counts.in_flight -= 1
            self._account(scope, status or HTTPStatus.INTERNAL_SERVER_ERROR, length, time.perf_counter() - began)
        request_id.reset(token)  # but not after a fault: the HTTP server has yet to log it

    def _id(self, scope: Scope) -> str:
        sent = next((value for name, value in scope["headers"] if name == HEADER), b"")
        return sent.decode() if _ID.fullmatch(sent) else next(self._made)

    def _account(self, scope: Scope, status: int, length: int, seconds: float) -> None:
        method = scope["method"]
        self._counts.count(getattr(scope.get("route"), "path", OTHER), method, status, seconds)
        if not self._is_told(status, scope["path"]):
            return
        fields = {"status": status, "ms": round(seconds * 1000, 3), "bytes": 0 if method == "HEAD" else length}
        if KEY_NAME in scope:
            fields["key"] = scope[KEY_NAME]
        if self._left_out:
            fields["left_out"] = self._left_out
            self._left_out = 0
        query = scope["query_string"].decode("latin-1")
        url = scope.get("raw_path", scope["path"].encode()).decode("latin-1") + (f"?{query}" if query else "")
        _log.info("%s %s", method, url, extra={FIELDS: fields})

    def _is_told(self, status: int, path: str) -> bool:
        """Whether this answer is logged. One that is not, because there were too many, is counted."""
        if self._which == "all":
            return True
        if self._which == "none" or status < HTTPStatus.BAD_REQUEST or status == CLIENT_LEFT or path == PROBED:
            return False
        is_ours = status >= HTTPStatus.INTERNAL_SERVER_ERROR
        if (self._ours if is_ours else self._theirs).take():
            return True
        self._left_out += 1
        self._counts.unlogged += 1
        return False
