"""The chunks of a world: what its revisions, its epoch and its generator have to say about an answer."""

from functools import partial
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Response

from chunkserver.grid import ChunkKey, check_key
from chunkserver.pipeline import ChunkRequest
from chunkserver.server.chunks import (
    GLB,
    IMMUTABLE,
    NATIVE,
    NO_STORE,
    REVALIDATE,
    Call,
    CallOfUrl,
    answer,
    check_generator,
    chunk_responses,
    encoding_like,
    format_of,
)
from chunkserver.server.openapi import RESOURCE, Responses, header
from chunkserver.server.parameters import (
    KeyOfUrl,
    WorldAnyQuery,
    WorldChunkQuery,
    WorldGlbQuery,
    WorldId,
    WorldNativeQuery,
    chunk_template,
    encoding_of,
    refuse_repeats,
)
from chunkserver.server.plan import Plan
from chunkserver.server.problems import OldEpoch, OtherGenerator, UnknownRevision, UnknownWorld
from chunkserver.server.store import WorldStore
from chunkserver.server.worlds import REVISION_PATTERN, WORLD
from chunkserver.wire import FORMATS, Encoding
from chunkserver.world import World

CHUNK: Final = f"{WORLD}/chunks/{{lod}}/{{x}}/{{y}}/{{z}}"


def _responses(*format_names: str) -> Responses:
    return chunk_responses(
        *format_names,
        cache_control=f"`{REVALIDATE}`; with `revision`, `g` and `epoch`: `{IMMUTABLE}`, or `{NO_STORE}` if the chunk "
        "was edited since.",
        problems=(UnknownWorld, OtherGenerator, OldEpoch, UnknownRevision),
        more_headers={
            "Chunk-Revision": header("The last edit of the chunk; 0 if there was none.", REVISION_PATTERN),
            "World-Revision": header("Of the world. Not on an immutable answer.", REVISION_PATTERN, required=False),
        },
    )


router: Final = APIRouter(
    dependencies=[Depends(refuse_repeats)], default_response_class=Response, tags=["chunks of a world"]
)


@router.api_route(f"{CHUNK}.mesh", methods=RESOURCE, summary="A chunk of a world, native", responses=_responses(NATIVE))
async def native_world_chunk(
    world: WorldId,
    key: KeyOfUrl,
    query: Annotated[WorldNativeQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk in the native format, as it is by now. An empty chunk is a 204."""
    return await _answer(call, world, key, query, Encoding(NATIVE, profile=query.profile))


@router.api_route(f"{CHUNK}.glb", methods=RESOURCE, summary="A chunk of a world as GLB", responses=_responses(GLB))
async def glb_world_chunk(
    world: WorldId,
    key: KeyOfUrl,
    query: Annotated[WorldGlbQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk as binary glTF, as it is by now. An empty chunk is a valid file without a mesh."""
    return await _answer(call, world, key, query, Encoding(GLB, frame=query.frame))


@router.api_route(
    CHUNK, methods=RESOURCE, summary="A chunk of a world, as `Accept` likes", responses=_responses(*FORMATS)
)
async def any_world_chunk(
    world: WorldId,
    key: KeyOfUrl,
    query: Annotated[WorldAnyQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk in the format that `Accept` chooses; the native one if it names none that is served."""
    return await _answer(call, world, key, query, encoding_of(format_of(call.request), query))


def revision_headers(world: World, chunk_revision: int, query: WorldChunkQuery) -> dict[str, str]:
    """Return what headers say of an answer's age: of the chunk, of the world, and how long it may be kept.

    Only a client that names the generator, the epoch and a revision has a URL that stands for these bytes for ever.

    Raises `UnknownRevision` if the world does not have the revision that the client names.
    """
    named = query.revision
    if named is not None and named > world.revision:
        message = f"world {world.id!r} is at revision {world.revision}; {named} is yet to come"
        raise UnknownRevision(message, revision=str(named), world_revision=str(world.revision))
    headers = {"Chunk-Revision": str(chunk_revision), "World-Revision": str(world.revision)}
    if named is None or query.g is None or query.epoch is None:
        return headers | {"Cache-Control": REVALIDATE}
    if chunk_revision > named:
        return headers | {"Cache-Control": NO_STORE}
    del headers["World-Revision"]  # it goes on, the answer does not
    return headers | {"Cache-Control": IMMUTABLE}


async def _answer(call: Call, name: str, key: ChunkKey, query: WorldChunkQuery, encoding: Encoding) -> Response:
    coded = encoding_like(call, encoding)
    plan = await world_plan(call.service.worlds, name, query, coded, key)
    return await answer(call, plan, key)


async def world_plan(
    worlds: WorldStore, name: str, query: WorldChunkQuery, encoding: Encoding, *keys: ChunkKey
) -> Plan:
    """Return how chunks of a world are answered, when it has the revision that is waited for; `keys` are some of them.

    What is refused anyway is refused at once. Raises `UnknownWorld`, `OtherGenerator`, `OldEpoch`, `OldGenerator`,
    `UnknownRevision`, `BadKey`, `BadParameter`; and `DeadlinePassed`.
    """
    world = worlds.find(name)
    template = _template(world, query, encoding)
    for key in keys:
        check_key(key, world.chunk_cells, world.lods, template.coarser)
    now = await worlds.at_revision(name, query.min_revision)
    if now.revision:
        await worlds.edits.open(now)
    if now.epoch != world.epoch:
        template = _template(now, query, encoding)
    headers = partial(_headers, worlds, name, now.epoch, query)
    headers(0)  # refuses a revision that is yet to come
    return Plan.of(
        template,
        headers,
        partial(worlds.holds, name, now.epoch),
        partial(worlds.revision, name),
        partial(worlds.edits.last_edit, now.epoch),
        partial(worlds.edits.bricks, now.epoch),
        now.epoch,
        now.lods,
    )


def _headers(worlds: WorldStore, name: str, epoch: str, query: WorldChunkQuery, chunk_revision: int) -> dict[str, str]:
    """Return `revision_headers` of the world of `epoch` as it is by now.

    Raises `UnknownWorld` if that is gone, and `OldEpoch` if it was created again.
    """
    world = worlds.find(name)
    if world.epoch != epoch:
        message = f"world {name!r} was created again while this chunk was waited for: epoch {epoch} is gone"
        raise OldEpoch(message, epoch=epoch, current=world.epoch)
    return revision_headers(world, chunk_revision, query)


def _template(world: World, query: WorldChunkQuery, encoding: Encoding) -> ChunkRequest:
    """Return what a URL asks for, whatever the chunk. Raises `OldEpoch`, `OldGenerator` or `BadParameter`."""
    if query.epoch not in (None, world.epoch):
        message = f"epoch is {query.epoch}; world {world.id!r} has {world.epoch} now"
        raise OldEpoch(message, epoch=query.epoch, current=world.epoch)
    check_generator(query.g, world.generator)
    return chunk_template(world.recipe, query, encoding, cells=world.chunk_cells, voxel_size=world.voxel_size)
