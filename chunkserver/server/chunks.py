"""The one answer behind all routes of chunks, and what those routes declare of it."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, Final, NamedTuple

from fastapi import Depends, Request, Response

from chunkserver.errors import BadKey, BadParameter, BadRecipe, DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.pipeline import ChunkRequest
from chunkserver.server.accept import preferred
from chunkserver.server.etag import is_known
from chunkserver.server.openapi import Responses, header, problem_responses
from chunkserver.server.parameters import IfNoneMatch
from chunkserver.server.presence import while_there
from chunkserver.server.problems import OldGenerator
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.wire import FORMATS, Encoding

REVALIDATE: Final = "no-cache"
IMMUTABLE: Final = "public, max-age=31536000, immutable"
VARY: Final = "Accept, Accept-Encoding"
NATIVE: Final = "mesh"
GLB: Final = "glb"
WITHOUT_BODY: Final = Encoding().format
"""The format in which an empty chunk is a 204. In the others it is a file without geometry."""
CLIENT_LEFT: Final = 499
"""Of an answer that nobody is there to read."""

MEDIA_TYPES: Final = {row.media_type: row.name for row in FORMATS.values()}
TO_BUILD: Final = (Unavailable, DeadlinePassed, Overloaded, WorkerLost)
"""What can happen to a request that waits for a worker."""

_CONTENT: Final = {"Chunk-Content": header("What the chunk is made of.", "^(air|rock|surface)$")}


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
        200: {"description": "The mesh.", "content": mesh, "headers": headers | _CONTENT},
        **({204: empty} if WITHOUT_BODY in format_names else {}),
        304: {"description": "The client has these bytes. Nothing was built.", "headers": headers},
        **problem_responses(BadKey, BadParameter, BadRecipe, OldGenerator, *problems, *TO_BUILD),
    }


class Asked(NamedTuple):
    """What every route of chunks is called with."""

    request: Request
    service: Service
    if_none_match: tuple[str, ...]


async def _asked(request: Request, service: ServiceOfApp, if_none_match: IfNoneMatch = ()) -> Asked:
    return Asked(request, service, if_none_match)


AskedOfUrl = Annotated[Asked, Depends(_asked)]


def format_of(request: Request) -> str:
    """Return the name of the format that `Accept` chooses; the native one if it names none that is served."""
    return MEDIA_TYPES[preferred(request.headers.getlist("accept"), MEDIA_TYPES)]


async def answer(
    asked: Asked, wanted: ChunkRequest, tag: str, headers: Mapping[str, str], holds: Callable[[], bool]
) -> Response:
    """Return the answer to a valid request: 304 if the client has it, else from the cache or the workers.

    tag: the entity tag, and the cache's key. headers: those besides `ETag`, `Vary` and what tells of the chunk.
    holds: whether the same request would be answered alike now. While it would, `Front` does it.
    """
    response = await _answer(asked, wanted, tag, {"ETag": f'"{tag}"', "Vary": VARY, **headers})
    asked.service.answers.keep(asked.request.scope, tag, response, holds)
    return response


async def _answer(asked: Asked, wanted: ChunkRequest, tag: str, sent: dict[str, str]) -> Response:
    if is_known(asked.if_none_match, tag):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=sent)
    service = asked.service
    chunk = service.cache.find(tag)
    if chunk is None:
        building = service.cache.get_or_build(tag, partial(service.pool.build, wanted))
        chunk = await while_there(asked.request.receive, building)
    if chunk is None:
        return Response(status_code=CLIENT_LEFT)
    sent["Chunk-Content"] = chunk.content
    if chunk.content != "surface" and wanted.encoding.format == WITHOUT_BODY:
        return Response(status_code=HTTPStatus.NO_CONTENT, headers=sent)
    return Response(chunk.body, media_type=FORMATS[wanted.encoding.format].media_type, headers=sent)


def check_generator(asked: str | None, current: str) -> None:
    """Raise `OldGenerator` if the client names another generator than the current one."""
    if asked not in (None, current):
        raise OldGenerator(f"g is {asked}; the generator is {current} now", g=asked, generator=current)
