"""Edits as a resource: one is appended to a world's log, and the log is read."""

import json
from contextlib import ExitStack
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue, WithJsonSchema

from chunkserver.edits import Edit
from chunkserver.errors import BadParameter, BadStroke, DeadlinePassed, Overloaded, StoreFull
from chunkserver.server.body import JSON_MEDIA_TYPE, json_body, parsed
from chunkserver.server.chunks import REVALIDATE
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.parameters import Decimal, NoQuery, Revision, WorldId, refuse_repeats
from chunkserver.server.problems import BodyTooLarge, BodyTooSlow, NotJson, OtherGenerator, UnknownWorld
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.server.worlds import REVISION_PATTERN, WORLD

EDITS: Final = f"{WORLD}/edits"
BODY_BYTES_MAX: Final = 8 << 20
"""Of a POST: some of the largest raw boxes."""
PUNCTUATION_MAX: Final = 1 << 16
"""Brackets, braces and commas of a body: more than twice those of the most strokes. A million of them keep the event
loop for seconds."""
EDITS_DEFAULT: Final = 100
EDITS_MAX: Final = 1000
"""Of one answer."""
KEY_PATTERN: Final = "^[!-~]{1,128}$"

_EXAMPLE: Final = {"op": "carve", "shape": "sphere", "center": [12, -3, 40.5], "radius": 6}
_CACHE_CONTROL: Final = {"Cache-Control": header("Always `no-cache`.")}


class NewEdit(BaseModel):
    """What is to be changed, in one piece."""

    model_config = ConfigDict(extra="forbid")

    strokes: list[JsonValue] = Field(
        description="One after the other; docs/edits/strokes.md has their ops, shapes and limits.",
        examples=[[_EXAMPLE]],
    )


class Range(BaseModel):
    """Chunks of a level."""

    lod: int
    min: tuple[int, int, int] = Field(description="The first x, y, z.")
    max: tuple[int, int, int] = Field(description="The last x, y, z, included.")


class Written(BaseModel):
    """An edit that is durable."""

    revision: str = Field(pattern=REVISION_PATTERN, description="Of the world with this edit. A decimal string.")
    duplicate: bool = Field(description="It had been written before, under the same key: this is the first answer.")
    stale: list[Range] = Field(description="The chunks that it may have changed, each once.")


class Logged(BaseModel):
    """An edit of the log."""

    revision: str = Field(pattern=REVISION_PATTERN)
    strokes: list[JsonValue] = Field(description="As they were sent, defaults written out.")
    stale: list[Range]


class Edits(BaseModel):
    """A part of a world's log."""

    edits: list[Logged] = Field(description="In their order, without a hole.")
    revision: str = Field(pattern=REVISION_PATTERN, description="Of the world: the log's last edit.")


class LogQuery(NoQuery):
    """Which part of the log."""

    after: Revision = Field(0, description="The edits behind this revision.")
    limit: Annotated[
        Decimal,
        Field(ge=1, le=EDITS_MAX),
        WithJsonSchema({"type": "integer", "minimum": 1, "maximum": EDITS_MAX}),
    ] = Field(EDITS_DEFAULT, description="At most so many.")


IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        pattern=KEY_PATTERN,
        description="Another name of this edit. Sent again with the same key, it is written once.",
    ),
]

router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], tags=["edits"])


@router.post(
    EDITS,
    summary="Edit a world",
    response_model=Written,
    responses={
        200: {"description": "It is durable, and in every chunk that is asked for from now on."},
        **problem_responses(
            *(BadParameter, BadStroke, UnknownWorld, OtherGenerator, BodyTooLarge, BodyTooSlow, NotJson),
            *(Overloaded, DeadlinePassed, StoreFull),
        ),
    },
    openapi_extra={
        "requestBody": {"required": True, "content": {JSON_MEDIA_TYPE: {"schema": NewEdit.model_json_schema()}}}
    },
)
async def edit_world(
    world: WorldId,
    _query: Annotated[NoQuery, Query()],
    request: Request,
    service: ServiceOfApp,
    key: IdempotencyKey = None,
) -> Response:
    """One edit: its strokes are applied as one. The answer comes when it is durable."""
    if len(keys := request.headers.getlist("idempotency-key")) > 1:
        raise BadParameter(f"Idempotency-Key is there {len(keys)} times; an edit has one")
    return await append(service, request, world, key)


async def append(service: Service, request: Request, world: str, key: str | None) -> Response:
    """Return the answer, a `Written`, when the edit that is the request's body is durable."""
    found, edits = service.worlds.find(world), service.worlds.edits
    with edits.counts.refusals(), ExitStack() as held:
        is_large = lambda: held.enter_context(service.bodies.large())  # noqa: E731
        edit = Edit.of(_strokes(await json_body(request, BODY_BYTES_MAX, is_large)))
        answer = await edits.take(found, edit, key)
    duplicate = b"true" if answer.duplicate else b"false"
    written = b'{"revision":"%d","duplicate":%b,"stale":%b}' % (answer.revision, duplicate, answer.stale)
    return Response(written, media_type=JSON_MEDIA_TYPE)


def _strokes(body: bytes) -> list[JsonValue]:
    found = sum(map(body.count, (b"[", b"{", b",")))
    if found > PUNCTUATION_MAX:
        expected = f"the body has {found} brackets, braces and commas; the limit is {PUNCTUATION_MAX}"
        raise BadStroke.at("strokes", expected, punctuation=found)
    return parsed(NewEdit, body).strokes


@router.api_route(
    EDITS,
    methods=RESOURCE,
    summary="The edits of a world",
    responses={
        200: {"description": "A part of the log.", "headers": _CACHE_CONTROL},
        **problem_responses(BadParameter, UnknownWorld, OtherGenerator),
    },
)
async def world_edits(
    world: WorldId, query: Annotated[LogQuery, Query()], service: ServiceOfApp, response: Response
) -> Edits:
    """The log from a revision on: the whole of it, read part by part, makes the world again."""
    response.headers["Cache-Control"] = REVALIDATE
    found = service.worlds.find(world)
    edits = await service.worlds.edits.read(found, query.after, query.limit)
    logged = [
        Logged(revision=str(revision), strokes=json.loads(source), stale=json.loads(stale))
        for revision, source, stale in edits
    ]
    return Edits(edits=logged, revision=str(service.worlds.find(world).revision))
