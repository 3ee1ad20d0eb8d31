"""Many chunks in one answer: `POST .../chunks`, streamed as they get ready, nearest first.

    chunks asked for, by distance -> what the client has, or the cache has: at once
                                  -> the workers, IN_FLIGHT_MAX at a time, each as soon as it is done

A browser opens six connections to a host, and a request costs more than a chunk that is ready: a batch has neither
limit. While the queue is full a batch waits, and asks again. When the client leaves, what is queued for it leaves too.
"""

import asyncio
import math
from collections import deque
from collections.abc import AsyncIterator
from functools import cache, partial
from http import HTTPStatus
from typing import Annotated, Any, Final, NamedTuple

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StrictInt

from chunkserver.errors import BadKey, BadParameter, BadRecipe, Overloaded, Unavailable
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk
from chunkserver.server.accept import urgency
from chunkserver.server.body import JSON_MEDIA_TYPE, json_body, parsed
from chunkserver.server.cache import Building
from chunkserver.server.chunks import NO_STORE, TO_BUILD
from chunkserver.server.frames import end, frame, stream_header
from chunkserver.server.openapi import Responses, header, problem_responses
from chunkserver.server.parameters import (
    Seed,
    SeedAnyQuery,
    WorldAnyQuery,
    WorldId,
    encoding_of,
    refuse_repeats,
)
from chunkserver.server.plan import IDENTITY, Plan, Version
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
    refusal,
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
REFUSED_SECONDS: Final = 0.1
"""What the full queue has refused is asked for again when one of the batch's own chunks is done, or after this time."""
BATCH_SECONDS_MAX: Final = 120.0
"""A batch that takes longer ends without its last frame."""


class Batch(BaseModel):
    """Which chunks, and how."""

    model_config = ConfigDict(extra="forbid")

    chunks: list[Annotated[list[StrictInt], Field(min_length=4, max_length=5)]] = Field(
        min_length=1,
        max_length=CHUNKS_MAX,
        description="The chunks: `[lod, x, y, z]` each, or `[lod, x, y, z, coarser]` with a mask of its own. Without "
        "one it has that of the query.",
        examples=[[[0, 1, -1, 3], [0, 2, -1, 3, 2]]],
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
    """Chunks of a world in one answer, each as soon as it is ready, nearest first, as it is by then."""
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
    plan: for chunks with its mask.
    """

    distance: float
    finer: int
    number: int
    key: ChunkKey
    plan: Plan


class _Work:
    """One batch on its way: what is still to be asked for, what is being built, and the frames that are ready."""

    def __init__(self, service: Service, plan: Plan, batch: Batch, request: Request) -> None:
        self._service = service
        self._request = request
        self._known = frozenset(batch.known)
        self._urgency = urgency(request.headers.get("priority", "").encode("latin-1"))
        self._count = len(batch.chunks)
        self._left = deque(_in_order(plan, batch))
        self._held: asyncio.TimerHandle | None = None
        self._building: dict[int, Building] = {}
        self._ready: list[bytes] = []
        self._changed = asyncio.Event()

    async def frames(self, world_revision: int) -> AsyncIterator[bytes]:
        """Yield the stream, as many frames at once as are ready. Closed early, it leaves the queue."""
        clock = asyncio.get_running_loop()
        deadline = clock.call_later(BATCH_SECONDS_MAX, self._changed.set)
        self._ready.append(stream_header(world_revision))
        try:
            while self._ask():
                if self._ready:
                    ready, self._ready = self._ready, []
                    yield b"".join(ready)
                else:
                    self._changed.clear()
                    await self._changed.wait()
                    if deadline.when() <= clock.time():
                        return
        finally:
            deadline.cancel()
            self._go_on()
            left, self._building = self._building, {}
            for building in left.values():
                self._service.cache.leave(building)
        yield end(self._count)

    def _ask(self) -> bool:
        """Go on until there is enough to send or to wait for. Return whether there is any."""
        size = 0
        while self._left and not self._held and len(self._building) < IN_FLIGHT_MAX and size < SEND_BYTES:
            size += self._ask_for(self._left.popleft())
        return bool(self._ready or self._building or self._left)

    def _hold(self, item: _Item) -> None:
        """Ask for `item` again later, and for nothing else before: the queue is full."""
        self._left.appendleft(item)
        self._held = self._held or asyncio.get_running_loop().call_later(REFUSED_SECONDS, self._go_on)

    def _go_on(self) -> None:
        if self._held:
            self._held.cancel()
            self._held = None
            self._changed.set()

    def _ask_for(self, item: _Item) -> int:
        """Ask for one chunk. Return the bytes that could be told of it at once."""
        cache, version = self._service.cache, item.plan.current(item.key)
        tag = version.tag
        if tag in self._known:
            return self._tell(item, HTTPStatus.NOT_MODIFIED, version)
        chunk = cache.find(tag)
        if chunk is not None:
            return self._tell_chunk(item, version, chunk)
        if self._service.pool.refuses(self._urgency, item.key.lod) and not cache.at_hand(tag):
            self._hold(item)
            return 0
        distance = item.distance / item.plan.template.cells
        build = item.plan.build(self._service.pool, version, self._urgency, distance)
        name = partial(item.plan.tag_shown, version)
        building = self._building[item.number] = cache.ask(tag, build, self._urgency, name)
        building.chunk.add_done_callback(partial(self._built, item, version))
        return 0

    def _built(self, item: _Item, version: Version, made: asyncio.Future[Chunk]) -> None:
        building = self._building.pop(item.number, None)
        if building is None:
            return  # the batch is over
        self._service.cache.leave(building)
        try:
            self._tell_chunk(item, version, made.result())
            self._go_on()
        except Overloaded:
            self._hold(item)
        except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 - whatever it was, it is this chunk's alone
            told = refusal(self._request, error if isinstance(error, Exception) else Unavailable("it was given up"))
            self._tell(item, told.status_code, body=bytes(told.body))
        self._changed.set()

    def _tell_chunk(self, item: _Item, asked: Version, chunk: Chunk) -> int:
        version = item.plan.shown(asked, chunk)
        status = item.plan.status(chunk)
        if status == HTTPStatus.NO_CONTENT:
            return self._tell(item, status, version, content=chunk.content)
        coding = item.plan.template.encoding.coding
        return self._tell(item, status, version, body=chunk.body, content=chunk.content, coding=coding)

    def _tell(
        self,
        item: _Item,
        status: int,
        version: Version | None = None,
        *,
        body: bytes = b"",
        content: str = "",
        coding: str = IDENTITY,
    ) -> int:
        revision, tag = (version.revision, version.tag) if version else (0, "")
        parts = frame(item.number, status, body=body, content=content, coding=coding, revision=revision, tag=tag)
        self._ready += parts
        return sum(map(len, parts))


def _in_order(plan: Plan, batch: Batch) -> list[_Item]:
    """Return the chunks of `batch`, nearest first. Raises `BadKey` or `BadParameter` that says which is wrong."""
    items = []
    cells, fitted = plan.template.cells, cache(plan.fitted)
    for number, (lod, x, y, z, *mask) in enumerate(batch.chunks):
        key = ChunkKey(lod, x, y, z)
        try:
            own = fitted(*mask) if mask else plan
            own.check(key)
        except (BadKey, BadParameter) as error:
            raise type(error)(f"chunks[{number}]: {error.message}", index=number, **error.values) from None
        if batch.viewer is None:
            items.append(_Item(0.0, 0, number, key, own))
        else:
            items.append(_Item(_distance(key, cells, *batch.viewer), -lod, number, key, own))
    return sorted(items)


def _distance(key: ChunkKey, cells: int, x: float, y: float, z: float) -> float:
    """Return how far the point (x, y, z) is from the chunk's box, in voxels."""
    side = cells << key.lod
    low_x, low_y, low_z = key.x * side, key.y * side, key.z * side
    return math.hypot(
        max(low_x - x, 0.0, x - (low_x + side)),
        max(low_y - y, 0.0, y - (low_y + side)),
        max(low_z - z, 0.0, z - (low_z + side)),
    )
