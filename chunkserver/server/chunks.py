"""The chunks of a seed's pristine world: a route for each format, one for `Accept`, and the one answer behind them."""

from collections.abc import Iterable
from functools import partial
from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from chunkserver.errors import BadKey, BadParameter, BadRecipe, DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.pipeline import ChunkRequest, generator
from chunkserver.server.accept import preferred
from chunkserver.server.etag import etag, is_known
from chunkserver.server.openapi import RESOURCE, Responses, header, problem_responses
from chunkserver.server.parameters import (
    AnyQuery,
    GlbQuery,
    IfNoneMatch,
    NativeQuery,
    PlaceOfUrl,
    chunk_request,
    encoding_of,
    refuse_repeats,
)
from chunkserver.server.problems import OldGenerator, UnknownRecipe
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.wire import ENCODING_DEFAULT, FORMATS, Encoding

REVALIDATE: Final = "no-cache"
IMMUTABLE: Final = "public, max-age=31536000, immutable"
VARY: Final = "Accept, Accept-Encoding"
WITHOUT_BODY: Final = ENCODING_DEFAULT.format
"""The format in which an empty chunk is a 204. In the others it is a file without geometry."""

MEDIA_TYPES: Final = {row.media_type: row.name for row in FORMATS.values()}

_HEADERS: Final = {
    "ETag": header("Strong: the same tag means the same bytes.", '^"[0-9a-f]+"$'),
    "Cache-Control": header(f"`{REVALIDATE}`, or with the current `g`: `{IMMUTABLE}`."),
    "Vary": header("The request headers that may change the answer.", f"^{VARY}$"),
}
_CONTENT: Final = {"Chunk-Content": header("What the chunk is made of.", "^(air|rock|surface)$")}


def _responses(*format_names: str) -> Responses:
    """The declarations of what a route of these formats answers."""
    mesh = {FORMATS[name].media_type: {"schema": {"type": "string", "format": "binary"}} for name in format_names}
    empty = {"description": "An empty chunk: nothing to draw.", "headers": _HEADERS | _CONTENT}
    return {
        200: {"description": "The mesh.", "content": mesh, "headers": _HEADERS | _CONTENT},
        **({204: empty} if WITHOUT_BODY in format_names else {}),
        304: {"description": "The client has these bytes. Nothing was built.", "headers": _HEADERS},
        **problem_responses(
            *(BadKey, BadParameter, BadRecipe, UnknownRecipe, OldGenerator),
            *(Unavailable, DeadlinePassed, Overloaded, WorkerLost),
        ),
    }


CHUNK: Final = "/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}"

router: Final = APIRouter(
    dependencies=[Depends(refuse_repeats)], default_response_class=Response, tags=["chunks of a seed"]
)


@router.api_route(f"{CHUNK}.mesh", methods=RESOURCE, summary="A chunk, native", responses=_responses("mesh"))
async def native_chunk(
    place: PlaceOfUrl, query: Annotated[NativeQuery, Query()], service: ServiceOfApp, if_none_match: IfNoneMatch = ()
) -> Response:
    """One chunk in the native format: typed arrays that engines upload as they are. An empty chunk is a 204."""
    wanted = chunk_request(place, query, Encoding("mesh", profile=query.profile), service.posted)
    return await answer(service, wanted, query.g, if_none_match)


@router.api_route(f"{CHUNK}.glb", methods=RESOURCE, summary="A chunk as GLB", responses=_responses("glb"))
async def glb_chunk(
    place: PlaceOfUrl, query: Annotated[GlbQuery, Query()], service: ServiceOfApp, if_none_match: IfNoneMatch = ()
) -> Response:
    """One chunk as binary glTF. An empty chunk is a valid file without a mesh."""
    wanted = chunk_request(place, query, Encoding("glb", frame=query.frame), service.posted)
    return await answer(service, wanted, query.g, if_none_match)


@router.api_route(CHUNK, methods=RESOURCE, summary="A chunk, as `Accept` likes", responses=_responses(*FORMATS))
async def any_chunk(
    request: Request,
    place: PlaceOfUrl,
    query: Annotated[AnyQuery, Query()],
    service: ServiceOfApp,
    if_none_match: IfNoneMatch = (),
) -> Response:
    """One chunk in the format that `Accept` chooses; the native one if it names none that is served."""
    format_name = MEDIA_TYPES[preferred(request.headers.getlist("accept"), MEDIA_TYPES)]
    wanted = chunk_request(place, query, encoding_of(format_name, query), service.posted)
    return await answer(service, wanted, query.g, if_none_match)


async def answer(service: Service, wanted: ChunkRequest, g: str | None, if_none_match: Iterable[str]) -> Response:
    """Return the answer to a valid request: 304 if the client has it, else from the cache or the workers.

    g: the generator token that the client believes in. Raises `OldGenerator` if it is not the current one.
    """
    check_generator(g, generator(wanted.recipe))
    tag = etag(wanted)
    headers = {"ETag": f'"{tag}"', "Cache-Control": IMMUTABLE if g else REVALIDATE, "Vary": VARY}
    if is_known(if_none_match, tag):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    chunk = await service.cache.get_or_build(tag, partial(service.pool.build, wanted))
    headers["Chunk-Content"] = chunk.content
    if chunk.content != "surface" and wanted.encoding.format == WITHOUT_BODY:
        return Response(status_code=HTTPStatus.NO_CONTENT, headers=headers)
    return Response(chunk.body, media_type=FORMATS[wanted.encoding.format].media_type, headers=headers)


def check_generator(asked: str | None, current: str) -> None:
    """Raise `OldGenerator` if the client names another generator than the current one."""
    if asked not in (None, current):
        raise OldGenerator(f"g is {asked}; the generator is {current} now", g=asked, generator=current)
