"""The one answer behind all routes of chunks, and what those routes declare of it."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Annotated, Any, Final, NamedTuple

from fastapi import Depends, Request, Response
from starlette.types import Receive

from chunkserver.errors import BadKey, BadParameter, BadRecipe, DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.grid import ChunkKey
from chunkserver.server.accept import preferred, preferred_coding, urgency
from chunkserver.server.answers import asked
from chunkserver.server.etag import is_known
from chunkserver.server.openapi import Responses, header, problem_responses
from chunkserver.server.parameters import IfNoneMatch
from chunkserver.server.plan import VARY, WITHOUT_BODY, Plan, Reply, Version
from chunkserver.server.presence import while_there
from chunkserver.server.problems import OldGenerator
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.wire import CODINGS, FORMATS, Encoding

REVALIDATE: Final = "no-cache"
NO_STORE: Final = "no-store"
IMMUTABLE: Final = "public, max-age=31536000, immutable"
NATIVE: Final = "mesh"
GLB: Final = "glb"
CLIENT_LEFT: Final = 499
"""Of an answer that nobody is there to read."""

MEDIA_TYPES: Final = {row.media_type: row.name for row in FORMATS.values()}
OFFERED: Final = tuple(reversed(CODINGS))
"""Content codings: at equal liking the one that costs less. A client that names none gets the plain bytes."""
TO_BUILD: Final = (Unavailable, DeadlinePassed, Overloaded, WorkerLost)
"""What can happen to a request that waits for a worker."""

_CONTENT: Final = {"Chunk-Content": header("What the chunk is made of.", "^(air|rock|surface)$")}
_CODING: Final = {
    "Content-Encoding": header("Unless the body is plain.", f"^({'|'.join(OFFERED[:-1])})$", required=False)
}


def chunk_responses(
    *format_names: str,
    cache_control: str,
    problems: Iterable[type[Exception]] = (),
    more_headers: Mapping[str, Any] | None = None,
) -> Responses:
    """Return the declarations of what a route answers that has chunks in these formats.

    cache_control: says which values the header has. problems, more_headers: those that not every such route has.
    """
    mesh = {FORMATS[name].media_type: {"schema": {"type": "string", "format": "binary"}} for name in format_names}
    headers = {
        "ETag": header("Strong: the same tag means the same bytes.", '^"[0-9a-f]+"$'),
        "Cache-Control": header(cache_control),
        "Vary": header("The request headers that may change the answer.", f"^{VARY}$"),
        **(more_headers or {}),
    }
    empty = {"description": "An empty chunk: nothing to draw.", "headers": headers | _CONTENT}
    return {
        200: {"description": "The mesh.", "content": mesh, "headers": headers | _CONTENT | _CODING},
        **({204: empty} if WITHOUT_BODY in format_names else {}),
        304: {"description": "The client has these bytes. Nothing was built.", "headers": headers},
        **problem_responses(BadKey, BadParameter, BadRecipe, OldGenerator, *problems, *TO_BUILD),
    }


class Call(NamedTuple):
    """What every route of chunks is called with."""

    request: Request
    service: Service
    if_none_match: tuple[str, ...]


async def _call(request: Request, service: ServiceOfApp, if_none_match: IfNoneMatch = ()) -> Call:
    return Call(request, service, if_none_match)


CallOfUrl = Annotated[Call, Depends(_call)]


def encoding_like(call: Call, encoding: Encoding) -> Encoding:
    """Return `encoding` in the content coding that the client likes best."""
    return encoding._replace(coding=preferred_coding(call.request.headers.getlist("accept-encoding"), OFFERED))


def format_of(request: Request) -> str:
    """Return the name of the format that `Accept` chooses; the native one if it names none that is served."""
    return MEDIA_TYPES[preferred(request.headers.getlist("accept"), MEDIA_TYPES)]


async def answer(call: Call, plan: Plan, key: ChunkKey) -> Response:
    """Return the answer to a valid request, for the chunk `key` of `plan`; the front learns both.

    Raises `BadKey`, and what `reply` raises.
    """
    scope, service = call.request.scope, call.service
    plan.check(key)
    version = plan.current(key)
    wanted = asked(scope)
    if wanted is not None:
        service.answers.learn(wanted, plan)
    urgent = urgency(call.request.headers.get("priority", "").encode("latin-1"))
    known = is_known(call.if_none_match, version.tag)
    made = await reply(service, plan, version, known, call.request.receive, urgent)
    if wanted is not None:
        service.answers.keep(wanted, plan, made)
    response = Response(made.body, made.status)
    response.raw_headers = list(made.headers)
    return response


async def reply(service: Service, plan: Plan, version: Version, known: bool, receive: Receive, urgent: int) -> Reply:
    """Return the answer to who asks for `version`: 304 if the client has it (`known`), else from cache or workers.

    It may be a later version, if the chunk is edited while it waits.

    urgent: see `Pool.build`, whose errors are raised.
    """
    if known:
        return plan.not_modified(version)
    chunk = service.cache.find(version.tag)
    if chunk is None:
        build, name = plan.build(service.pool, version, urgent), partial(plan.tag_shown, version)
        chunk = await while_there(receive, service.cache.get_or_build(version.tag, build, urgent, name))
    return Reply(CLIENT_LEFT, (), b"") if chunk is None else plan.found(version, chunk)


def check_generator(asked: str | None, current: str) -> None:
    """Raise `OldGenerator` if the client names another generator than the current one."""
    if asked not in (None, current):
        raise OldGenerator(f"g is {asked}; the generator is {current} now", g=asked, generator=current)
