"""Every error as problem+json (RFC 9457): one table from error to status, type and title, installed by one loop."""

import json
import logging
import math
from collections.abc import Mapping
from http import HTTPStatus
from itertools import islice
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import iter_route_contexts
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from chunkserver.errors import (
    BadKey,
    BadParameter,
    BadRecipe,
    BadRequest,
    BadStroke,
    ChunkError,
    DeadlinePassed,
    Overloaded,
    StoreFull,
    Unavailable,
    WorkerLost,
    WorldGone,
)
from chunkserver.server.pool import BuildFault

MEDIA_TYPE: Final = "application/problem+json"
TYPE_PREFIX: Final = "urn:chunkserver:problem:"
INSTANCE_PREFIX: Final = "urn:chunkserver:request:"
REQUEST_ID: Final = "chunkserver.request_id"
"""Where the scope of a request has its id, if it has one."""
RETRY_SOON_SECONDS: Final = 1
VALUES_MAX: Final = 16
"""Offending values in one answer."""
VALUE_CHARS_MAX: Final = 200
"""Characters of each of them, and of its name, that are sent back."""
DETAIL_CHARS_MAX: Final = 1000
JSON_INTEGER_MAX: Final = (1 << 53) - 1
"""Larger integers are answered as decimal strings: JavaScript would round them."""
RESERVED: Final = frozenset({"type", "title", "status", "detail", "instance"})

logger: Final = logging.getLogger("chunkserver.server")


class Problem(NamedTuple):
    """One kind of failure as clients see it. `name` never changes once released; `title` may.

    Without a name it is nothing but its HTTP status: RFC 9457 calls that `about:blank`.
    """

    status: int
    name: str
    title: str
    retry_after: int | None = None

    @property
    def type(self) -> str:
        """The problem type, a URI."""
        return TYPE_PREFIX + self.name if self.name else "about:blank"


class OldGenerator(ChunkError):
    """The client asks for the terrain of a generator that this server does not run."""


class UnknownRecipe(ChunkError):
    """No built-in recipe has this name, and no recipe that is kept this digest."""


class UnknownWorld(ChunkError):
    """No world has this id."""


class UnknownRevision(ChunkError):
    """The world does not have this revision yet."""


class WorldExists(ChunkError):
    """Another world has this id."""


class OtherGenerator(ChunkError):
    """The world was created by another generator than this server's."""


class OldEpoch(ChunkError):
    """The client asks for a world that was deleted, or whose history was replaced."""


class NotJson(ChunkError):
    """The body is of another media type than JSON."""


class MalformedHttp(ChunkError):
    """What came over the connection is not HTTP."""


class HeadTooSlow(ChunkError):
    """The head of a request did not arrive in time."""


class UrlTooLong(ChunkError):
    """The URL is over its limit."""


class HeadTooLarge(ChunkError):
    """The head of a request has too many bytes, or too many fields."""


class TooManyConnections(Unavailable):
    """As many connections are open as may be, and none of them can be given up."""


class KeyNeeded(ChunkError):
    """The request needs an API key and has none."""


class UnknownKey(ChunkError):
    """The request has an API key that is not known here."""


class ScopeNeeded(ChunkError):
    """The API key is good, but not for this."""


class OriginRefused(ChunkError):
    """A page of a site that may not use this server."""


class BodyTooLarge(ChunkError):
    """The body is over its limit; what is left of it is not read."""

    headers: Final = {"Connection": "close"}


class BodyTooSlow(ChunkError):
    """The body did not arrive in time; what is left of it is not read."""

    headers: Final = {"Connection": "close"}


PROBLEMS: Final[dict[type[Exception] | int, Problem]] = {
    BadRequest: Problem(400, "bad-request", "The request cannot be answered"),
    BadKey: Problem(422, "bad-key", "The chunk lies outside the world"),
    BadStroke: Problem(422, "bad-stroke", "The edit has a stroke that cannot be applied"),
    BadRecipe: Problem(422, "bad-recipe", "The recipe or the seed cannot be built"),
    BadParameter: Problem(422, "bad-parameter", "A parameter is malformed, unknown or not built"),
    RequestValidationError: Problem(422, "bad-parameter", "A parameter is malformed, unknown or not built"),
    OldGenerator: Problem(410, "old-generator", "The server has another generator now"),
    OldEpoch: Problem(410, "old-epoch", "Another world has this id now"),
    UnknownWorld: Problem(404, "unknown-world", "There is no such world"),
    WorldGone: Problem(404, "unknown-world", "There is no such world"),
    UnknownRevision: Problem(404, "unknown-revision", "The world does not have this revision yet"),
    WorldExists: Problem(409, "world-exists", "Another world has this id"),
    OtherGenerator: Problem(409, "other-generator", "The world was created by another generator"),
    UnknownRecipe: Problem(404, "unknown-recipe", "This recipe is not known here"),
    BodyTooSlow: Problem(408, "body-too-slow", "The body did not arrive in time"),
    BodyTooLarge: Problem(413, "body-too-large", "The body is over its limit"),
    NotJson: Problem(415, "not-json", "The body is not JSON"),
    MalformedHttp: Problem(400, "malformed-http", "The request is not HTTP"),
    HeadTooSlow: Problem(408, "head-too-slow", "The head of the request did not arrive in time"),
    UrlTooLong: Problem(414, "url-too-long", "The URL is over its limit"),
    HeadTooLarge: Problem(431, "head-too-large", "The head of the request is over its limits"),
    TooManyConnections: Problem(503, "too-many-connections", "Too many connections are open", RETRY_SOON_SECONDS),
    KeyNeeded: Problem(401, "key-needed", "This needs an API key"),
    UnknownKey: Problem(401, "unknown-key", "The API key is not known here"),
    ScopeNeeded: Problem(403, "scope-needed", "The API key is not good for this"),
    OriginRefused: Problem(403, "origin-refused", "Pages of this site may not use the server"),
    StoreFull: Problem(507, "store-full", "There is no room for more"),
    404: Problem(404, "not-found", "Nothing is here"),
    405: Problem(405, "method-not-allowed", "The resource does not have this method"),
    Unavailable: Problem(503, "unavailable", "The server is not ready", RETRY_SOON_SECONDS),
    WorkerLost: Problem(503, "worker-lost", "The workers that built this ended", RETRY_SOON_SECONDS),
    Overloaded: Problem(503, "overloaded", "Too many requests are waiting", RETRY_SOON_SECONDS),
    DeadlinePassed: Problem(503, "deadline-passed", "The answer was not ready in time", RETRY_SOON_SECONDS),
    ChunkError: Problem(500, "internal", "The server failed"),
    Exception: Problem(500, "internal", "The server failed"),
}
"""Keys are error classes, which cover their subclasses, and HTTP statuses that the framework raises."""


def install(app: FastAPI) -> None:
    """Answer every error of `app` from `PROBLEMS`."""
    for error in (*PROBLEMS, HTTPException):
        app.add_exception_handler(error, answer)


async def answer(request: Request, error: Exception) -> Response:
    """Answer an error as the framework wants it to be: see `refusal`."""
    return refusal(request, error)


def refusal(request: HTTPConnection, error: Exception) -> Response:
    """Return the problem+json of `error`; a failure of the server is logged with its cause, never shown."""
    problem = _problem(error)
    if problem.status == HTTPStatus.INTERNAL_SERVER_ERROR and _is_untold(error):
        logger.error("%s %s failed", _method(request), request.url.path, exc_info=error)
    detail, values = _account(request, error)
    headers = dict(getattr(error, "headers", None) or {}) | {"Cache-Control": "no-store"}
    if problem.status == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = _allowed(request)
    if problem.retry_after is not None:
        headers["Retry-After"] = str(problem.retry_after)
    body = problem_body(problem, detail, values, request.scope.get(REQUEST_ID, ""))
    return Response(json.dumps(body, allow_nan=False), problem.status, headers, MEDIA_TYPE)


def problem_body(
    problem: Problem, detail: str, values: Mapping[str, object], request_id: str = ""
) -> dict[str, object]:
    """Return the members of one problem: the standard ones, then the offending values, cut to their limits."""
    named = [(name[:VALUE_CHARS_MAX], value) for name, value in values.items() if name not in RESERVED]
    return {
        "type": problem.type,
        "title": problem.title,
        "status": problem.status,
        "detail": detail[:DETAIL_CHARS_MAX],
        **({"instance": INSTANCE_PREFIX + quote(request_id)} if request_id else {}),
        **{name: _member(value) for name, value in named[:VALUES_MAX]},
    }


def problem_of(kind: type[Exception]) -> Problem:
    """Return how errors of a class are answered."""
    return next(PROBLEMS[above] for above in kind.__mro__ if above in PROBLEMS)


def _problem(error: Exception) -> Problem:
    if isinstance(error, HTTPException):
        status = HTTPStatus(error.status_code)
        return PROBLEMS.get(status, Problem(status, "", status.phrase))
    return problem_of(type(error))


def _method(request: HTTPConnection) -> str:
    method: str = request.scope.get("method", "WEBSOCKET")
    return method


def _allowed(request: HTTPConnection) -> str:
    """The methods of all routes of this path: the framework names those of the first alone."""
    routes = iter_route_contexts(request.app.routes)
    fitting = (route.methods or () for route in routes if route.path_regex.match(request.url.path))
    return ", ".join(sorted(set().union(*fitting)))


def _is_untold(error: Exception) -> bool:
    """Whether nobody else logs it: what is no `ChunkError` is raised again, and logged by the HTTP server."""
    return isinstance(error, ChunkError) and not isinstance(error, BuildFault)


def _account(request: HTTPConnection, error: Exception) -> tuple[str, Mapping[str, object]]:
    """What to tell about `error`: a sentence, and the values it speaks of."""
    match error:
        case RequestValidationError():
            return _validation_account(error.errors())
        case HTTPException():
            found = {"method": _method(request)} if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED else {}
            return str(error.detail), {"path": request.url.path, **found}
        case ChunkError() if _problem(error).status != HTTPStatus.INTERNAL_SERVER_ERROR:
            return error.message, error.values
        case _:
            return "the cause is in the server's log", {}


def _validation_account(faults: Any) -> tuple[str, Mapping[str, object]]:
    sentences, values = [], {}
    told = (fault for fault in faults if fault["type"] != "none_required")  # that it may be left out, they know
    for fault in islice(told, VALUES_MAX):
        name = str(fault["loc"][1])[:VALUE_CHARS_MAX]  # behind "path" or "query"
        unknown = fault["type"] == "extra_forbidden"
        sentences.append(f"{name} {'is not a parameter of this resource' if unknown else fault['msg']}")
        values[name] = fault["input"]
    return "; ".join(sentences), values


def _member(value: object) -> object:
    match value:
        case bool() | None:
            return value
        case int() if abs(value) <= JSON_INTEGER_MAX:
            return value
        case float() if math.isfinite(value):
            return value
        case _:
            return str(value)[:VALUE_CHARS_MAX]
