"""Which pages of other sites may read what is served, and write (the Fetch standard's CORS protocol).

A page may read by GET, HEAD and by a batch of chunks. It may write only if its site is named: with any site allowed,
every page that somebody opens could change the worlds of a server on the same machine. No cookies are ever involved.
"""

from collections.abc import Iterable
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

ANY: Final = "*"
PREFLIGHT_SECONDS: Final = 7200
"""How long a browser may remember what it was told; none does for longer."""
READING: Final = b"GET, HEAD"
BATCH: Final = b"GET, HEAD, POST"
WRITING: Final = b"GET, HEAD, POST, DELETE"
BATCH_PATH_END: Final = "/chunks"
SENT: Final = b"Authorization, Content-Type, Idempotency-Key, If-None-Match, Priority, X-Request-Id"
"""Request headers that a page may send besides those that are always allowed."""
EXPOSED: Final = b"*"
"""Response headers that a page may read: with requests without cookies, all."""

Headers = tuple[tuple[bytes, bytes], ...]

_READABLE: Final = (b"access-control-allow-origin", b"*"), (b"access-control-expose-headers", EXPOSED)
_VARY: Final = (b"vary", b"Origin")


class Cors:
    """What pages of `origins` are allowed: each a scheme, host and port as browsers send it, or "*" for any.

    any: whether pages of any site may read.
    """

    def __init__(self, origins: Iterable[str]) -> None:
        names = frozenset(origin.encode("latin-1") for origin in origins)
        self.any = ANY.encode() in names
        self._named = names - {ANY.encode()}

    def names(self, origin: bytes) -> bool:
        """Return whether pages of `origin` may write."""
        return origin in self._named

    def headers(self, origin: bytes | None) -> Headers:
        """Return what every answer to a page of `origin` says; None is a client that is no page.

        With any site allowed it is always the same, so that a cache may give one client's answer to another.
        """
        if self.any:
            return _READABLE
        if not self._named:
            return ()
        if origin not in self._named:
            return (_VARY,)
        assert origin is not None
        return (b"access-control-allow-origin", origin), (b"access-control-expose-headers", EXPOSED), _VARY

    def preflight(self, origin: bytes, path: str) -> Headers:
        """Return what a page of `origin` may do with `path`."""
        if not (self.any or origin in self._named):
            return self.headers(origin)
        methods = READING
        if origin in self._named:
            methods = WRITING
        elif path.endswith(BATCH_PATH_END):
            methods = BATCH
        return (
            *self.headers(origin),
            (b"access-control-allow-methods", methods),
            (b"access-control-allow-headers", SENT),
            (b"access-control-max-age", b"%d" % PREFLIGHT_SECONDS),
        )


class CorsLayer:
    """ASGI: answers preflights, and adds to every other answer what `cors` says."""

    def __init__(self, app: ASGIApp, cors: Cors) -> None:
        self._app = app
        self._cors = cors

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or let the application do it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        fields = dict(scope["headers"])
        origin = fields.get(b"origin")
        if scope["method"] == "OPTIONS" and origin is not None and b"access-control-request-method" in fields:
            headers = self._cors.preflight(origin, scope["path"])
            await send({"type": "http.response.start", "status": 204, "headers": headers})
            await send({"type": "http.response.body", "body": b""})
            return
        added = self._cors.headers(origin)

        async def send_with_cors(message: Message) -> None:
            if added and message["type"] == "http.response.start":
                message = {**message, "headers": (*message["headers"], *added)}
            await send(message)

        await self._app(scope, receive, send_with_cors)
