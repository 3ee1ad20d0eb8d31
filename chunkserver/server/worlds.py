"""Worlds as resources: created, listed, described, deleted."""

import asyncio
import re
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, WithJsonSchema
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticCustomError

from chunkserver.errors import BadParameter, BadRecipe, StoreFull
from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, LOD_MAX
from chunkserver.pipeline import ChunkRequest, check_request, generator
from chunkserver.recipe import WorldRecipe, canonical
from chunkserver.server.body import JSON_MEDIA_TYPE, json_body, parsed
from chunkserver.server.chunks import REVALIDATE, TO_BUILD
from chunkserver.server.descriptor import Descriptor, Urls, members
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.parameters import DECIMAL, TOKEN, Decimal, NoQuery, WorldId, refuse_repeats
from chunkserver.server.posted import DIGEST_PATTERN, PostedRecipes, digest_of, source_of
from chunkserver.server.problems import (
    BodyTooLarge,
    BodyTooSlow,
    NotJson,
    OtherGenerator,
    UnknownRecipe,
    UnknownWorld,
    WorldExists,
)
from chunkserver.server.recipes import BODY_BYTES_MAX as RECIPE_BYTES_MAX
from chunkserver.server.recipes import FIRST_CHUNK, WRITTEN, accept
from chunkserver.server.service import Service, ServiceOfApp
from chunkserver.server.store import check_generator_of
from chunkserver.world import ID_PATTERN, LODS_DEFAULT, VOXEL_SIZE_DEFAULT, WORLDS_MAX, World

BODY_BYTES_MAX: Final = RECIPE_BYTES_MAX + (1 << 12)
"""Of a POST: the largest recipe, and what stands around it."""
PAGE_DEFAULT: Final = 100
PAGE_MAX: Final = 1000
REVISION_PATTERN: Final = "^(0|[1-9][0-9]{0,18})$"

WORLDS: Final = "/v1/worlds"
WORLD: Final = f"{WORLDS}/{{world}}"


def _seed(given: Any) -> int:
    if isinstance(given, int):
        return given  # true and false are left to the strict model
    if isinstance(given, str) and re.fullmatch(DECIMAL, given):
        return int(given)
    raise PydanticCustomError("seed", 'must be an integer, or a decimal string in its shortest form, such as "-3"')


class NewWorld(BaseModel):
    """What a world is created from."""

    model_config = ConfigDict(extra="forbid", strict=True)

    id: str = Field(pattern=ID_PATTERN, examples=["my-world"])
    seed: Annotated[
        int,
        BeforeValidator(_seed),
        WithJsonSchema({"anyOf": [{"type": "integer"}, {"type": "string", "pattern": f"^(?:{DECIMAL})$"}]}),
    ] = Field(description="A signed 64-bit integer, as a number or as a decimal string.", examples=["42"])
    recipe: Annotated[
        JsonValue, WithJsonSchema({"anyOf": [*WRITTEN, {"type": "string", "pattern": DIGEST_PATTERN}]})
    ] = Field(
        description="The name of a built-in recipe, the digest of any, or what could be posted.", examples=["terrain"]
    )
    voxel_size: float = Field(VOXEL_SIZE_DEFAULT, gt=0, allow_inf_nan=False, description="Metres.")
    lods: int = Field(LODS_DEFAULT, ge=1, le=LOD_MAX + 1, description="Levels of detail.")
    chunk_cells: int = Field(
        CELLS_DEFAULT, description="Cells a side of a chunk.", json_schema_extra={"enum": [*CELLS_BUILT]}
    )


class Identity(BaseModel):
    """Which world, and which state of it."""

    id: str = Field(pattern=ID_PATTERN)
    epoch: str = Field(pattern=TOKEN, description="Random. A world that is deleted and created again has another one.")
    revision: str = Field(pattern=REVISION_PATTERN, description="How many edits it has taken. A decimal string.")
    created: str = Field(description="UTC, ISO 8601.")


class ListedWorld(Identity):
    """One world of the list."""

    seed: str = Field(pattern=f"^(?:{DECIMAL})$")
    recipe: str = Field(description="The name of a built-in recipe, or the digest.")
    generator: str = Field(pattern=TOKEN, description="The one that created it.")


class Worlds(BaseModel):
    """One page of the list of worlds, by id."""

    worlds: list[ListedWorld]
    next: str | None = Field(description="Goes into `after` for the next page; null on the last.")
    count: int = Field(description="Of all worlds.")
    count_max: int = WORLDS_MAX
    durable: bool = Field(description="Whether worlds outlive the server.")


class Limits(BaseModel):
    """What bounds a request."""

    answer_seconds: float = Field(description="How long a request waits at most, for a worker or for a revision.")


class WorldDescriptor(Descriptor, Identity):
    """A world."""

    durable: bool = Field(description="Whether it outlives the server.")
    limits: Limits


class PageQuery(NoQuery):
    """Which page of the list."""

    after: Annotated[str, Field(pattern=ID_PATTERN)] | SkipJsonSchema[None] = Field(
        None, description="The list goes on behind this id."
    )
    limit: Annotated[
        Decimal,
        Field(ge=1, le=PAGE_MAX),
        WithJsonSchema({"type": "integer", "minimum": 1, "maximum": PAGE_MAX}),
    ] = Field(PAGE_DEFAULT, description="Worlds on a page, at most.")


_CACHE_CONTROL: Final = {"Cache-Control": header("Always `no-cache`.")}
_LOCATION: Final = {"Location": header("Where the world is.", "^/v1/worlds/[a-z0-9_-]+$")}
_BODY: Final = {
    "schema": NewWorld.model_json_schema(),
    "examples": {
        "a name": {"value": {"id": "my-world", "seed": "42", "recipe": "terrain"}},
        "a recipe of its own": {
            "value": {
                "id": "bowl",
                "seed": 7,
                "voxel_size": 0.5,
                "lods": 4,
                "chunk_cells": 16,
                "recipe": {"op": "subtract", "a": {"op": "y"}, "b": {"op": "sphere", "radius": 20}},
            }
        },
    },
}

router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], tags=["worlds"])


@router.api_route(
    WORLDS,
    methods=RESOURCE,
    summary="The worlds",
    responses={
        200: {"description": "A page of the list.", "headers": _CACHE_CONTROL},
        **problem_responses(BadParameter),
    },
)
async def list_worlds(query: Annotated[PageQuery, Query()], service: ServiceOfApp, response: Response) -> Worlds:
    """All worlds by id, a page at a time. A world that another generator has created is listed too."""
    response.headers["Cache-Control"] = REVALIDATE
    found = service.worlds.page(query.after or "", query.limit + 1)
    shown = found[: query.limit]
    return Worlds(
        worlds=[_listed(world) for world in shown],
        next=shown[-1].id if len(found) > len(shown) else None,
        count=len(service.worlds),
        durable=service.worlds.durable,
    )


@router.post(
    WORLDS,
    summary="Create a world",
    status_code=HTTPStatus.CREATED,
    responses={
        201: {"description": "It is there from now on.", "headers": _LOCATION},
        200: {
            "description": "It was there already, the same.",
            "headers": _LOCATION,
            "model": WorldDescriptor,
        },
        **problem_responses(
            *(BadParameter, BadRecipe, UnknownRecipe, BodyTooLarge, BodyTooSlow, NotJson),
            *(WorldExists, OtherGenerator, StoreFull),
            *TO_BUILD,
        ),
    },
    openapi_extra={"requestBody": {"required": True, "content": {JSON_MEDIA_TYPE: _BODY}}},
)
async def create_world(
    request: Request, _query: Annotated[NoQuery, Query()], service: ServiceOfApp, response: Response
) -> WorldDescriptor:
    """A recipe that is not known here is accepted as by a POST of the recipe. The answer comes when the world is kept.

    The same once more does no harm: the answer is the world that is there, as it is by now. Other content under the
    same id is refused.
    """
    body = await json_body(request, BODY_BYTES_MAX)
    wanted = await asyncio.to_thread(_wanted, body, service.posted)
    await accept(service, wanted.recipe.source)
    world = await service.worlds.create(wanted)
    _check_same(world, wanted)
    check_generator_of(world)
    response.headers["Location"] = f"{WORLDS}/{world.id}"
    response.status_code = HTTPStatus.CREATED if world is wanted else HTTPStatus.OK
    return await _described(world, service)


@router.api_route(
    WORLD,
    methods=RESOURCE,
    summary="The descriptor of a world",
    responses={
        200: {"description": "The descriptor.", "headers": _CACHE_CONTROL},
        **problem_responses(BadParameter, UnknownWorld, OtherGenerator),
    },
)
async def world_descriptor(
    world: WorldId, _query: Annotated[NoQuery, Query()], service: ServiceOfApp, response: Response
) -> WorldDescriptor:
    """Everything that a client must know before it asks for a chunk."""
    response.headers["Cache-Control"] = REVALIDATE
    return await _described(service.worlds.find(world), service)


@router.delete(
    WORLD,
    summary="Delete a world",
    status_code=HTTPStatus.NO_CONTENT,
    responses={204: {"description": "It is gone."}, **problem_responses(BadParameter, UnknownWorld)},
)
async def delete_world(world: WorldId, _query: Annotated[NoQuery, Query()], service: ServiceOfApp) -> None:
    """For good. Whoever creates it again gets another epoch."""
    await service.worlds.delete(world)


def _wanted(body: bytes, posted: PostedRecipes) -> World:
    """Return the world that a body asks for. Raises `BadParameter`, `BadRecipe` or `UnknownRecipe`."""
    given = parsed(NewWorld, body)
    name = given.recipe if isinstance(given.recipe, str) else None
    source = canonical(given.recipe) if name is None else source_of(name, posted)
    recipe = WorldRecipe(given.seed, source)
    world = World(
        id=given.id,
        recipe=recipe,
        recipe_name=name or digest_of(source),
        generator=generator(recipe),
        voxel_size=given.voxel_size,
        lods=given.lods,
        chunk_cells=given.chunk_cells,
    )
    check_request(ChunkRequest(recipe, FIRST_CHUNK, world.chunk_cells, world.voxel_size))
    return world


def _check_same(there: World, wanted: World) -> None:
    """Raise `WorldExists` if the world that is there was created from something else."""
    for name in ("recipe", "voxel_size", "lods", "chunk_cells"):
        if getattr(there, name) != getattr(wanted, name):
            raise WorldExists(f"there is a world {there.id!r} already, with another {name}", id=there.id)


def _identity(world: World) -> dict[str, str]:
    return {"id": world.id, "epoch": world.epoch, "revision": str(world.revision), "created": world.created}


def _listed(world: World) -> ListedWorld:
    return ListedWorld(
        **_identity(world), seed=str(world.recipe.seed), recipe=world.recipe_name, generator=world.generator
    )


async def _described(world: World, service: Service) -> WorldDescriptor:
    errors = await service.errors.find(world.recipe)
    chunk = f"{WORLDS}/{world.id}/chunks/{{lod}}/{{x}}/{{y}}/{{z}}{{extension}}"
    tokens = f"g={world.generator}&epoch={world.epoch}"
    urls = Urls(chunk=chunk, chunk_immutable=f"{chunk}?revision={{revision}}&{tokens}")
    return WorldDescriptor(
        **_identity(world),
        **members(world.recipe, world.recipe_name, urls, errors, world.chunk_cells, world.lods),
        voxel_size=world.voxel_size,
        durable=service.worlds.durable,
        limits=Limits(answer_seconds=service.worlds.answer_seconds),
    )
