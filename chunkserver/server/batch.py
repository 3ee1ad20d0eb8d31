"""Many chunks in one answer: `POST .../chunks`, streamed as they get ready, nearest first.

    chunks asked for, by distance -> what the client has, or the cache has: at once
                                  -> the workers, IN_FLIGHT_MAX at a time, each as soon as it is done

A browser opens six connections to a host, and a request costs more than a chunk that is ready: a batch has neither
limit. When the client leaves, what is queued for it leaves the queue.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Iterator, Sequence
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, Final, NamedTuple

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StrictInt

from chunkserver.errors import BadKey, BadParameter, BadRecipe, ChunkError
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.server.accept import urgency
from chunkserver.server.body import JSON_MEDIA_TYPE, json_body, parsed
from chunkserver.server.chunks import NO_STORE, TO_BUILD
from chunkserver.server.frames import chunk_frame, end, frame, stream_header
from chunkserver.server.openapi import Responses, header, problem_responses
from chunkserver.server.parameters import (
    Seed,
    SeedAnyQuery,
    WorldAnyQuery,
    WorldId,
    encoding_of,
    refuse_repeats,
)
from chunkserver.server.plan import Plan
from chunkserver.server.problems import (
    BodyTooLarge,
    BodyTooSlow,
    NotJson,
    OldEpoch,
    OldGenerator,
    OtherGenerator,
    UnknownRecipe,
    UnknownRevision,
    UnknownWorld,
    answer,
)
from chunkserver.server.seeds import SEED, seed_plan
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.server.world_chunks import world_plan
from chunkserver.server.worlds import REVISION_PATTERN, WORLD
from chunkserver.wire import CODINGS, FORMATS, Encoding

MEDIA_TYPE: Final = "application/vnd.chunkserver.batch"
CHUNKS_MAX: Final = 1024
"""Chunks of one batch."""
BODY_BYTES_MAX: Final = 1 << 17
"""Of a request: all chunks far away, and an entity tag for each."""
IN_FLIGHT_MAX: Final = 32
"""Chunks of one batch that wait for workers or are being built: a batch must not fill the queue for all others."""
SEND_BYTES: Final = 1 << 18
"""What is ready is sent when it is so much, and when nothing more is ready."""
BATCH_SECONDS_MAX: Final = 120.0
"""A batch that takes longer ends without its last frame."""

Coordinate = StrictInt
"""Of a chunk; its range is checked with the key."""


class Batch(BaseModel):
    """Which chunks, and how."""

    model_config = ConfigDict(extra="forbid")

    chunks: list[tuple[Coordinate, Coordinate, Coordinate, Coordinate]] = Field(
        min_length=1,
        max_length=CHUNKS_MAX,
        description="The chunks: `[lod, x, y, z]` each.",
        examples=[[[0, 1, -1, 3]]],
    )
    viewer: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = Field(
        None, description="Where the viewer is, in voxels: nearer chunks come first. Without it they come as listed."
    )
    known: list[str] = Field(
        [],
        max_length=CHUNKS_MAX,
        description="Entity tags, without quotes, of chunks that the client has: each is a 304.",
    )
    format: str = Field(Encoding().format, description="Of every chunk.", json_schema_extra={"enum": list(FORMATS)})
    coding: str = Field(
        Encoding().coding, description="Content coding of every chunk.", json_schema_extra={"enum": list(CODINGS)}
    )


def _declared(*problems: type[Exception]) -> dict[str, Any]:
    """Return what both routes declare of their body and their answers."""
    headers = {
        "Cache-Control": header(f"Always `{NO_STORE}`.", f"^{NO_STORE}$"),
        "World-Revision": header("Of a world.", REVISION_PATTERN, required=False),
    }
    stream = {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}
    responses: Responses = {
        200: {"description": "Frames, as docs/wire/batch-v1.md says.", "content": stream, "headers": headers},
        **problem_responses(
            BadKey, BadParameter, BadRecipe, OldGenerator, BodyTooLarge, BodyTooSlow, NotJson, *problems, *TO_BUILD
        ),
    }
    body = {"required": True, "content": {JSON_MEDIA_TYPE: {"schema": Batch.model_json_schema()}}}
    return {"responses": responses, "openapi_extra": {"requestBody": body}}


router: Final = APIRouter(
    dependencies=[Depends(refuse_repeats)], default_response_class=Response, tags=["batches of chunks"]
)


@router.post(f"{SEED}/chunks", summary="Many chunks of a seed", **_declared(UnknownRecipe))
async def seed_batch(
    seed: Seed, query: Annotated[SeedAnyQuery, Query()], request: Request, service: ServiceOfApp
) -> Response:
    """Chunks of a seed's pristine world in one answer, each as soon as it is ready, nearest first."""
    batch = parsed(Batch, await json_body(request, BODY_BYTES_MAX))
    plan = seed_plan(service.posted, seed, query, _encoding(batch, query))
    return _stream(_Work(service, plan, batch, request), 0, {})


@router.post(
    f"{WORLD}/chunks",
    summary="Many chunks of a world",
    **_declared(UnknownWorld, OtherGenerator, OldEpoch, UnknownRevision),
)
async def world_batch(
    world: WorldId, query: Annotated[WorldAnyQuery, Query()], request: Request, service: ServiceOfApp
) -> Response:
    """Chunks of a world in one answer, each as soon as it is ready, nearest first; all of one revision."""
    batch = parsed(Batch, await json_body(request, BODY_BYTES_MAX))
    plan = await world_plan(service.worlds, world, query, _encoding(batch, query))
    revision = service.worlds.find(world).revision
    return _stream(_Work(service, plan, batch, request), revision, {"World-Revision": str(revision)})


def _encoding(batch: Batch, query: SeedAnyQuery | WorldAnyQuery) -> Encoding:
    if batch.format not in FORMATS:
        raise BadParameter(f"format is {batch.format!r}; built are {list(FORMATS)}", format=batch.format)
    return encoding_of(batch.format, query)._replace(coding=batch.coding)


def _stream(work: "_Work", world_revision: int, headers: dict[str, str]) -> Response:
    headers |= {"Cache-Control": NO_STORE, "X-Accel-Buffering": "no"}  # a proxy must not wait for the last chunk
    return StreamingResponse(work.frames(world_revision), headers=headers, media_type=MEDIA_TYPE)


class _Item(NamedTuple):
    """One chunk of a batch. Sorted as they are: nearest first, the coarser of two that are as near, then as listed.

    distance: in voxels, from the viewer to the nearest point of the chunk.
    """

    distance: float
    finer: int
    number: int
    request: ChunkRequest


class _Work:
    """One batch on its way: what is still to be asked for, what is being built, and the frames that are ready."""

    def __init__(self, service: Service, plan: Plan, batch: Batch, request: Request) -> None:
        self._service = service
        self._plan = plan
        self._request = request
        self._known = frozenset(batch.known)
        self._urgency = urgency(request.headers.get("priority", "").encode("latin-1"))
        self._items = _in_order(plan, batch)
        self._building: set[asyncio.Task[None]] = set()
        self._ready: list[bytes] = []
        self._changed = asyncio.Event()

    async def frames(self, world_revision: int) -> AsyncIterator[bytes]:
        """Yield the stream, as many frames at once as are ready. Closed early, it leaves the queue."""
        clock = asyncio.get_running_loop().time
        deadline = clock() + BATCH_SECONDS_MAX
        self._ready.append(stream_header(world_revision))
        items = iter(self._items)
        try:
            while self._ask(items):
                if self._ready:
                    ready, self._ready = self._ready, []
                    yield b"".join(ready)
                else:
                    self._changed.clear()
                    async with asyncio.timeout_at(deadline):
                        await self._changed.wait()
        finally:
            for task in self._building:
                task.cancel()
        yield end(len(self._items))

    def _ask(self, items: Iterator[_Item]) -> bool:
        """Go on until there is enough to send or to wait for. Return whether there is any."""
        size = 0
        while len(self._building) < IN_FLIGHT_MAX and size < SEND_BYTES:
            item = next(items, None)
            if item is None:
                break
            at_once = self._at_once(item)
            if at_once is None:
                self._building.add(asyncio.create_task(self._build(item)))
            else:
                self._ready.append(at_once)
                size += len(at_once)
        return bool(self._ready or self._building)

    def _at_once(self, item: _Item) -> bytes | None:
        tag = self._plan.tag(item.request.key)
        if tag in self._known:
            return frame(item.number, HTTPStatus.NOT_MODIFIED, revision=item.request.revision, tag=tag)
        chunk = self._service.cache.find(tag)
        return None if chunk is None else self._frame(item, tag, chunk)

    async def _build(self, item: _Item) -> None:
        tag = self._plan.tag(item.request.key)
        build = partial(
            self._service.pool.build,
            item.request,
            urgency=self._urgency,
            distance=item.distance / item.request.cells,
        )
        try:
            chunk = await self._service.cache.get_or_build(tag, build)
        except ChunkError as error:
            told = await answer(self._request, error)
            self._ready.append(frame(item.number, told.status_code, body=bytes(told.body)))
        else:
            self._ready.append(self._frame(item, tag, chunk))
        finally:
            self._building.discard(asyncio.current_task())
            self._changed.set()

    def _frame(self, item: _Item, tag: str, chunk: Chunk) -> bytes:
        status, coding = self._plan.status(chunk), item.request.encoding.coding
        return chunk_frame(item.number, chunk, status, coding=coding, revision=item.request.revision, tag=tag)


def _in_order(plan: Plan, batch: Batch) -> list[_Item]:
    """Return the chunks of `batch`, nearest first. Raises `BadKey` that says which one there cannot be."""
    items = []
    for index, chunk in enumerate(batch.chunks):
        try:
            request = plan.request(ChunkKey(*chunk))
        except BadKey as error:
            raise BadKey(f"chunks[{index}]: {error.message}", index=index, **error.values) from None
        distance = 0.0 if batch.viewer is None else _distance(request, batch.viewer)
        items.append(_Item(distance, -request.key.lod if batch.viewer else 0, index, request))
    return sorted(items, key=lambda item: item[:3])


def _distance(request: ChunkRequest, viewer: Sequence[float]) -> float:
    """Return how far the viewer is from the chunk's box, in voxels."""
    side = request.cells * request.key.step
    lows = request.key.low_corner(request.cells)
    return math.hypot(*(max(low - at, 0.0, at - (low + side)) for low, at in zip(lows, viewer, strict=True)))
