"""A seed's pristine world, which nobody has to create: its descriptor and its chunks."""

from collections.abc import Sequence
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Response

from chunkserver.errors import BadParameter, BadRecipe
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe
from chunkserver.server.chunks import (
    GLB,
    IMMUTABLE,
    NATIVE,
    REVALIDATE,
    Call,
    CallOfUrl,
    answer,
    check_generator,
    chunk_responses,
    encoding_like,
    format_of,
)
from chunkserver.server.descriptor import Descriptor, Urls, members
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.parameters import (
    KeyOfUrl,
    Seed,
    SeedAnyQuery,
    SeedChunkQuery,
    SeedGlbQuery,
    SeedNativeQuery,
    SeedQuery,
    chunk_template,
    encoding_of,
    pristine,
    refuse_repeats,
)
from chunkserver.server.plan import Plan
from chunkserver.server.posted import PostedRecipes, known
from chunkserver.server.problems import UnknownRecipe
from chunkserver.server.service import ServiceOfApp
from chunkserver.wire import FORMATS, Encoding


class SeedDescriptor(Descriptor):
    """A seed's pristine world."""


SEED: Final = "/v1/seeds/{seed}"
CHUNK: Final = f"{SEED}/chunks/{{lod}}/{{x}}/{{y}}/{{z}}"

_REFUSALS: Final = (BadRecipe, UnknownRecipe)
_CACHE_CONTROL: Final = f"`{REVALIDATE}`, or with the current `g`: `{IMMUTABLE}`."

router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], tags=["seeds"])


@router.api_route(
    SEED,
    methods=RESOURCE,
    summary="The descriptor of a seed's pristine world",
    responses={
        200: {"description": "The descriptor.", "headers": {"Cache-Control": header("Always `no-cache`.")}},
        **problem_responses(BadParameter, *_REFUSALS),
    },
)
async def seed_descriptor(
    seed: Seed, query: Annotated[SeedQuery, Query()], service: ServiceOfApp, response: Response
) -> SeedDescriptor:
    """Everything that a client must know before it asks for a chunk. Nothing has to be created first."""
    response.headers["Cache-Control"] = REVALIDATE
    recipe = pristine(seed, query.recipe, service.posted)
    return describe(recipe, query.recipe, await service.errors.find(recipe))


@router.api_route(
    f"{CHUNK}.mesh",
    methods=RESOURCE,
    summary="A chunk of a seed, native",
    response_class=Response,
    responses=chunk_responses(NATIVE, cache_control=_CACHE_CONTROL, problems=_REFUSALS),
)
async def native_chunk(
    seed: Seed,
    key: KeyOfUrl,
    query: Annotated[SeedNativeQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk in the native format: typed arrays that engines upload as they are. An empty chunk is a 204."""
    return await _answer(call, seed, key, query, Encoding(NATIVE, profile=query.profile))


@router.api_route(
    f"{CHUNK}.glb",
    methods=RESOURCE,
    summary="A chunk of a seed as GLB",
    response_class=Response,
    responses=chunk_responses(GLB, cache_control=_CACHE_CONTROL, problems=_REFUSALS),
)
async def glb_chunk(
    seed: Seed,
    key: KeyOfUrl,
    query: Annotated[SeedGlbQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk as binary glTF. An empty chunk is a valid file without a mesh."""
    return await _answer(call, seed, key, query, Encoding(GLB, frame=query.frame))


@router.api_route(
    CHUNK,
    methods=RESOURCE,
    summary="A chunk of a seed, as `Accept` likes",
    response_class=Response,
    responses=chunk_responses(*FORMATS, cache_control=_CACHE_CONTROL, problems=_REFUSALS),
)
async def any_chunk(
    seed: Seed,
    key: KeyOfUrl,
    query: Annotated[SeedAnyQuery, Query()],
    call: CallOfUrl,
) -> Response:
    """One chunk in the format that `Accept` chooses; the native one if it names none that is served."""
    return await _answer(call, seed, key, query, encoding_of(format_of(call.request), query))


def describe(recipe: WorldRecipe, name: str, errors: Sequence[float] | None) -> SeedDescriptor:
    """Return the descriptor of the pristine world `recipe`, whose recipe is called `name`.

    errors: the geometric error of each level, voxels; None if it is not known.
    """
    chunk = f"/v1/seeds/{recipe.seed}/chunks/{{lod}}/{{x}}/{{y}}/{{z}}{{extension}}?recipe={name}"
    urls = Urls(chunk=chunk, chunk_immutable=f"{chunk}&g={generator(recipe)}")
    return SeedDescriptor(**members(recipe, name, urls, errors))


async def _answer(call: Call, seed: int, key: ChunkKey, query: SeedChunkQuery, encoding: Encoding) -> Response:
    return await answer(call, seed_plan(call.service.posted, seed, query, encoding_like(call, encoding)), key)


def seed_plan(posted: PostedRecipes, seed: int, query: SeedChunkQuery, encoding: Encoding) -> Plan:
    """Return how chunks of `seed` are answered. Raises `BadParameter`, `BadRecipe`, `UnknownRecipe`, `OldGenerator`."""
    template = chunk_template(pristine(seed, query.recipe, posted), query, encoding)
    check_generator(query.g, generator(template.recipe))
    headers = {"Cache-Control": IMMUTABLE if query.g else REVALIDATE}
    return Plan.of(template, lambda _: headers, known(template.recipe.digest, posted))
