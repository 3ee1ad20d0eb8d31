"""Who may do what: one table from method and path to the scope that is needed, asked before anything else is done.

    request -> is the scope that it needs free here? -> application
                   | no
                   v
               does its key cover it? -> application, whose answer then is for this client alone
                   | no
                   v
               401, 403

A resource that has no row needs `admin`: what somebody forgets to enter is shut, not open.
"""

import ipaddress
import json
import re
import socket
from collections import defaultdict
from collections.abc import Collection, Iterable
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qsl

from fastapi import Response
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Asked

from chunkserver.errors import BadSetting, ChunkError
from chunkserver.server.cors import Cors
from chunkserver.server.keys import Keyring, Scope
from chunkserver.server.openapi import problem_responses
from chunkserver.server.problems import MEDIA_TYPE, PROBLEMS, KeyNeeded, ScopeNeeded, UnknownKey, problem_body
from chunkserver.server.request_counts import RequestCounts
from chunkserver.server.tickets import Tickets

KEY_NAME: Final = "chunkserver.key"
"""Where the name of the key stands in the ASGI scope of a request that needed one."""
GRANTED: Final = "chunkserver.scope"
"""Where the scope of what may be done stands there, if not everything may."""
TICKET: Final = b"ticket"
"""The parameter of a WebSocket's URL that stands for a key."""
SCHEME: Final = "key"
"""What the OpenAPI document calls the way in which a key is sent."""
STREAM: Final = "WEBSOCKET"
"""Stands for the method of a WebSocket."""
POLICY_VIOLATION: Final = 1008
"""RFC 6455: the close code of a WebSocket that is refused, where the server cannot answer with a status."""


class Row(NamedTuple):
    """Resources that need the same: `scope`, or nothing.

    looks: whether a key, or a ticket, that covers more than `scope` makes a difference: it is looked at, also where
        none is needed.
    """

    scope: Scope | None
    method: str
    paths: tuple[str, ...]
    looks: bool = False


NEEDS: Final = (
    Row(
        Scope.READ,
        "GET",
        (
            "/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}",
            "/v1/worlds/{world}/chunks/{lod}/{x}/{y}/{z}",
            "/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}.mesh",
            "/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}.glb",
            "/v1/worlds/{world}/chunks/{lod}/{x}/{y}/{z}.mesh",
            "/v1/worlds/{world}/chunks/{lod}/{x}/{y}/{z}.glb",
            "/v1/seeds/{seed}",
            "/v1/worlds",
            "/v1/worlds/{world}",
            "/v1/worlds/{world}/edits",
            "/v1/recipes",
            "/v1/recipes/{recipe}",
            "/about",
            "/docs",
            "/openapi.json",
            "/metrics",
        ),
    ),
    Row(None, "GET", ("/livez", "/readyz", "/", "/assets/{name}")),
    Row(Scope.READ, "POST", ("/v1/worlds/{world}/chunks", "/v1/seeds/{seed}/chunks")),
    Row(Scope.READ, "POST", ("/v1/worlds/{world}/tickets",), looks=True),
    Row(Scope.READ, STREAM, ("/v1/worlds/{world}/stream",), looks=True),
    Row(Scope.EDIT, "POST", ("/v1/recipes", "/v1/worlds/{world}/edits")),
    Row(Scope.ADMIN, "POST", ("/v1/worlds",)),
    Row(Scope.ADMIN, "DELETE", ("/v1/worlds/{world}",)),
)
"""HEAD needs what GET does. OPTIONS is free: a browser asks it without a key, before it sends one."""


class Exposed(BadSetting):
    """The server would listen for others than this machine, and let everybody do everything."""


class Table:
    """`rows`, to be asked by the path of a request."""

    def __init__(self, rows: Iterable[Row]) -> None:
        by_method: dict[str, list[Row]] = defaultdict(list)
        for row in rows:
            by_method[row.method].append(row)
        self._rows = {
            method: (re.compile("|".join(map(_pattern, found))), found) for method, found in by_method.items()
        }
        self._rows["HEAD"] = self._rows["GET"]

    def row(self, method: str, path: str) -> Row:
        """Return the row of a request."""
        if method == "OPTIONS":
            return _FREE
        pattern, rows = self._rows.get(method, _NO_ROWS)
        found = pattern.fullmatch(path)
        return rows[(found.lastindex or 1) - 1] if found else _SHUT


_NO_ROWS: Final[tuple[re.Pattern[str], list[Row]]] = (re.compile("(?!)"), [])
_FREE: Final = Row(None, "OPTIONS", ())
_SHUT: Final = Row(Scope.ADMIN, "", ())


class Access:
    """ASGI: lets through to `app` what needs no key, and what comes with one that covers it.

    anonymous: what may be done without a key; None: nothing that needs one.
    tickets: that a WebSocket may come with, in the place of a key.
    counts: where refusals are counted.
    cors: which pages of other sites may read why they are refused; by default none.

    An answer that needed a key is not for a cache that serves others: where it says `public`, it then says `private`.
    Without `public`, RFC 9111 (3.5) forbids such a cache to use it again anyway. `Vary: Authorization` is not needed:
    whoever may have a resource gets the same bytes.
    """

    def __init__(
        self,
        app: ASGIApp,
        keyring: Keyring,
        anonymous: Scope | None = None,
        cors: Cors | None = None,
        needs: Iterable[Row] = NEEDS,
        counts: RequestCounts | None = None,
        tickets: Tickets | None = None,
    ) -> None:
        self._app = app
        self._keyring = keyring
        self._cors = cors or Cors(())
        self._counts = counts or RequestCounts()
        self._tickets = Tickets() if tickets is None else tickets
        self._anonymous = anonymous
        self._table = Table(needs)
        self._free = {scope for scope in Scope if anonymous is not None and anonymous.covers(scope)}

    async def __call__(self, asked: Asked, receive: Receive, send: Send) -> None:
        """Answer 401 or 403, or let the application answer."""
        if asked["type"] == "lifespan":
            await self._app(asked, receive, send)
            return
        needed, _, _, looks = self._table.row(asked.get("method", STREAM), asked["path"])
        if needed is None or (needed in self._free and not (looks and _comes_with_key(asked))):
            asked[GRANTED] = self._anonymous
            await self._app(asked, receive, send)
            return
        try:
            asked[KEY_NAME], asked[GRANTED] = self._granted(asked, needed)
        except (KeyNeeded, UnknownKey, ScopeNeeded) as error:
            await self._refuse(error, asked, receive, send)
        else:
            await self._app(asked, receive, _privately(send))

    def describe(self, document: dict[str, Any]) -> None:
        """Write into an OpenAPI document which operations need a key, of which scope, and how others are refused."""
        document["components"]["securitySchemes"] = {SCHEME: {"type": "http", "scheme": "bearer"}}
        refusals = {str(status): row for status, row in problem_responses(KeyNeeded, UnknownKey, ScopeNeeded).items()}
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                needed = self._table.row(method.upper(), path).scope
                if needed is not None and needed not in self._free:
                    operation["security"] = [{SCHEME: [str(needed)]}]
                    operation["responses"] = {**refusals, **operation["responses"]}

    def _granted(self, asked: Asked, needed: Scope) -> tuple[str, Scope]:
        """Return the name of the key that a request comes with, and its scope."""
        if asked["type"] == "websocket" and (token := dict(parse_qsl(asked.get("query_string", b""))).get(TICKET)):
            ticket = self._tickets.take(token.decode("latin-1"), asked["path"])
            if ticket is None:
                raise UnknownKey("the ticket is not known here: it is good once, and not for long")
            return ticket.name, ticket.scope
        given = [value for name, value in asked["headers"] if name == b"authorization"]
        scheme, _, key = given[0].partition(b" ") if len(given) == 1 else (b"", b"", b"")
        if scheme.lower() != b"bearer":
            raise KeyNeeded(f"this needs an API key of scope {needed}: `Authorization: Bearer KEY`", scope=str(needed))
        found = self._keyring.find(key.strip())
        if found is None:
            raise UnknownKey("this server does not know the API key")
        if not found.scope.covers(needed):
            message = f"this needs scope {needed}; the API key {found.name!r} has {found.scope}"
            raise ScopeNeeded(message, scope=str(needed), has=str(found.scope))
        return found.name, found.scope

    async def _refuse(self, error: ChunkError, asked: Asked, receive: Receive, send: Send) -> None:
        if asked["type"] == "websocket" and "websocket.http.response" not in asked.get("extensions", {}):
            await send({"type": "websocket.close", "code": POLICY_VIOLATION})
            return
        problem = PROBLEMS[type(error)]
        self._counts.count_refusal(asked.get("method", STREAM), problem.status)
        challenge = {
            KeyNeeded: "Bearer",
            UnknownKey: 'Bearer error="invalid_token"',
            ScopeNeeded: f'Bearer error="insufficient_scope", scope="{error.values.get("scope")}"',
        }[type(error)]
        body = json.dumps(problem_body(problem, error.message, error.values))
        headers = {"WWW-Authenticate": challenge, "Cache-Control": "no-store"}
        response = Response(body, problem.status, headers, MEDIA_TYPE)
        response.raw_headers += self._cors.headers(dict(asked["headers"]).get(b"origin"))
        await response(asked, receive, send)


def scope_of(asked: Asked) -> Scope:
    """Return what a request may do that has come through."""
    granted: Scope | None = asked.get(GRANTED, Scope.ADMIN)
    return Scope.READ if granted is None else granted


def _comes_with_key(asked: Asked) -> bool:
    """Whether a request comes with a key, or a ticket."""
    has_key = any(name == b"authorization" for name, _ in asked["headers"])
    return has_key or TICKET in dict(parse_qsl(asked.get("query_string", b"")))


def check_exposure(host: str, keys: Collection[object], insecure: bool) -> None:
    """Raise `Exposed` if `host` is not this machine alone, there are no `keys`, and nobody has said `insecure`.

    A name counts as what it resolves to. Raises OSError if it does not: nothing can listen there either.
    """
    if keys or insecure or (host and all(map(_is_loopback, _addresses(host)))):
        return
    message = (
        f"{host or 'every address'} can be reached from outside of this machine, and without API keys everybody may "
        "create and delete worlds: configure API keys (`chunkserver key new`), listen on 127.0.0.1, or say --insecure"
    )
    raise Exposed(message, host=host)


def _pattern(row: Row) -> str:
    """Return a group that matches the paths of a row, as the router does: a parameter is anything without a slash."""
    return f"({'|'.join(_PARAMETER.sub('[^/]+', re.escape(path)) for path in row.paths)})"


_PARAMETER: Final = re.compile(re.escape(re.escape("{")) + "[a-z]+" + re.escape(re.escape("}")))
"""In a path whose special characters are escaped."""


def _privately(send: Send) -> Send:
    async def send_privately(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = [
                (name, value.replace(b"public", b"private")) if name == b"cache-control" else (name, value)
                for name, value in message["headers"]
            ]
            message = {**message, "headers": headers}
        await send(message)

    return send_privately


def _addresses(host: str) -> list[str]:
    return [str(found[4][0]) for found in socket.getaddrinfo(host, None)]


def _is_loopback(address: str) -> bool:
    parsed = ipaddress.ip_address(address.partition("%")[0])
    mapped = getattr(parsed, "ipv4_mapped", None)
    return (mapped or parsed).is_loopback
