"""Recipes as resources: the built-in ones by name, any of them by digest, and new ones by POST."""

import asyncio
import inspect
import json
from collections.abc import Callable, Iterable
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import BaseModel, Field, TypeAdapter

from chunkserver.errors import BadParameter, BadRecipe
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.server.body import JSON_MEDIA_TYPE, json_body
from chunkserver.server.chunks import IMMUTABLE, REVALIDATE, TO_BUILD
from chunkserver.server.etag import body_etag, etag, is_known
from chunkserver.server.openapi import RESOURCE, Responses, header, problem_responses
from chunkserver.server.parameters import RECIPE_NAMES, IfNoneMatch, NoQuery, refuse_repeats
from chunkserver.server.posted import DIGEST_PATTERN, PostedRecipes, digest_of, source_by_digest, source_of
from chunkserver.server.problems import BodyTooLarge, BodyTooSlow, NotJson, UnknownRecipe
from chunkserver.server.service import Service, ServiceOfApp

BODY_BYTES_MAX: Final = 1 << 16
"""Of a posted recipe; the same as the limit on its canonical JSON."""
FIRST_CHUNK: Final = ChunkKey(0, 0, 0, 0)

Digest = Annotated[str, Field(pattern=DIGEST_PATTERN, description="Names the expression; the same in every server.")]


class Recipe(BaseModel):
    """A recipe, as it stands under its digest: nothing of it ever changes."""

    digest: Digest
    expression: dict[str, Any] = Field(description="The expression tree, every default written out. Can be posted.")


class Builtin(BaseModel):
    """A built-in recipe, without its expression."""

    name: str
    description: str
    digest: Digest
    parameters: dict[str, dict[str, Any]] = Field(
        description='What may stand beside `"builtin"` in a body: a JSON Schema each, with its default.'
    )


class BuiltinRecipe(Recipe, Builtin):
    """A built-in recipe, with the expression that its default parameters make."""


class PostedCount(BaseModel):
    """How many posted recipes are kept. When one more would pass a limit, the least recently used is forgotten."""

    count: int
    count_max: int
    bytes: int
    bytes_max: int
    body_bytes_max: int = Field(default=BODY_BYTES_MAX, description="The limit on the body of one POST.")


class Recipes(BaseModel):
    """All built-in recipes, and what room there is for others."""

    recipes: list[Builtin]
    posted: PostedCount


def _described(name: str, function: Callable[..., object]) -> Builtin:
    parameters = inspect.signature(function, eval_str=True).parameters.values()
    return Builtin(
        name=name,
        description=" ".join((inspect.getdoc(function) or "").partition("\n\n")[0].split()),
        digest=digest_of(builtin(name)),
        parameters={
            found.name: {**TypeAdapter(found.annotation).json_schema(), "default": found.default}
            for found in parameters
        },
    )


DESCRIBED: Final = {name: _described(name, function) for name, function in BUILTINS.items()}
"""What there is to say about each built-in recipe."""

_HEADERS: Final = {
    "ETag": header("Strong: the same tag means the same bytes.", '^"[0-9a-f]+"$'),
    "Cache-Control": header(f"Of a recipe under its digest: `{IMMUTABLE}`. Else `{REVALIDATE}`."),
}
_NOT_MODIFIED: Final[Responses] = {304: {"description": "The client has these bytes.", "headers": _HEADERS}}
_LOCATION: Final = {"Location": header("Where the recipe is.", "^/v1/recipes/[0-9a-f]+$")}

WRITTEN: Final[list[dict[str, Any]]] = [
    {"type": "object", "required": ["op"], "properties": {"op": {"type": "string"}}},
    {"type": "object", "required": ["builtin"], "properties": {"builtin": {"enum": sorted(BUILTINS)}}},
    {"enum": sorted(BUILTINS)},
    {"type": "number"},
]
"""The schemas of what can be written for a recipe."""

_BODY: Final = {
    "schema": {"anyOf": WRITTEN},
    "examples": {
        "an expression": {
            "value": {
                "op": "max",
                "a": {"op": "y"},
                "b": {"op": "subtract", "a": 8, "b": {"op": "sphere", "radius": 20}},
            }
        },
        "a built-in with parameters": {"value": {"builtin": "planet", "radius": 6_400_000}},
        "a number": {"value": 1},
    },
}

router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], default_response_class=Response, tags=["recipes"])


@router.api_route(
    "/v1/recipes",
    methods=RESOURCE,
    summary="The built-in recipes",
    responses={
        200: {"description": "The list.", "model": Recipes, "headers": _HEADERS},
        **_NOT_MODIFIED,
        **problem_responses(BadParameter),
    },
)
async def list_recipes(
    _query: Annotated[NoQuery, Query()], service: ServiceOfApp, if_none_match: IfNoneMatch = ()
) -> Response:
    """Every built-in recipe with its parameters; and how many posted ones are kept, which are listed nowhere."""
    posted = service.posted
    count = PostedCount(count=len(posted), count_max=posted.count_max, bytes=posted.bytes, bytes_max=posted.bytes_max)
    return _answer(Recipes(recipes=list(DESCRIBED.values()), posted=count), REVALIDATE, if_none_match)


@router.api_route(
    "/v1/recipes/{recipe}",
    methods=RESOURCE,
    summary="A recipe",
    responses={
        200: {"description": "The recipe.", "model": BuiltinRecipe | Recipe, "headers": _HEADERS},
        **_NOT_MODIFIED,
        **problem_responses(BadParameter, UnknownRecipe),
    },
)
async def get_recipe(
    recipe: Annotated[str, Path(description="A built-in's name, or any digest.", json_schema_extra=RECIPE_NAMES)],
    _query: Annotated[NoQuery, Query()],
    service: ServiceOfApp,
    if_none_match: IfNoneMatch = (),
) -> Response:
    """The expression tree of a recipe. Under a digest there is nothing else, so that answer may be kept for ever."""
    found = _recipe(_found(recipe, service.posted))
    if recipe not in DESCRIBED:
        return _answer(found, IMMUTABLE, if_none_match)
    named = BuiltinRecipe(**DESCRIBED[recipe].model_dump(), expression=found.expression)
    return _answer(named, REVALIDATE, if_none_match)


@router.post(
    "/v1/recipes",
    summary="Post a recipe",
    status_code=HTTPStatus.CREATED,
    responses={
        201: {"description": "It is kept from now on.", "model": Recipe, "headers": _LOCATION},
        200: {"description": "It was known already.", "model": Recipe, "headers": _LOCATION},
        **problem_responses(BadParameter, BadRecipe, BodyTooLarge, BodyTooSlow, NotJson, *TO_BUILD),
    },
    openapi_extra={"requestBody": {"required": True, "content": {JSON_MEDIA_TYPE: _BODY}}},
)
async def post_recipe(request: Request, _query: Annotated[NoQuery, Query()], service: ServiceOfApp) -> Response:
    """An expression tree, a number, or a built-in with parameters. Its digest then names it wherever a recipe is named.

    It is accepted once its first chunk is built. Posting it again does no harm, and is how to bring it back after it
    was forgotten.
    """
    source = await asyncio.to_thread(canonical, await json_body(request, BODY_BYTES_MAX))
    recipe = _recipe(source)
    status = HTTPStatus.CREATED if await accept(service, source) else HTTPStatus.OK
    headers = {"Location": f"/v1/recipes/{recipe.digest}"}
    return Response(recipe.model_dump_json(), status, headers, JSON_MEDIA_TYPE)


def _recipe(source: str) -> Recipe:
    return Recipe(digest=digest_of(source), expression=json.loads(source))


def _found(name: str, posted: PostedRecipes) -> str:
    try:
        return source_of(name, posted)
    except BadRecipe as error:
        raise UnknownRecipe(error.message, **error.values) from None


async def accept(service: Service, source: str) -> bool:
    """Keep the recipe whose canonical JSON is `source`, and return whether it was new.

    Raises `BadRecipe` if its first chunk cannot be built: some limits are known only where it is run.
    """
    if source_by_digest(digest_of(source), service.posted) is not None:
        return False
    wanted = ChunkRequest(WorldRecipe(0, source), FIRST_CHUNK)
    await service.cache.get_or_build(etag(wanted), partial(service.pool.build, wanted))
    service.posted.add(source)
    return True


def _answer(value: BaseModel, cache_control: str, if_none_match: Iterable[str]) -> Response:
    body = value.model_dump_json().encode()
    tag = body_etag(body)
    headers = {"ETag": f'"{tag}"', "Cache-Control": cache_control}
    if is_known(if_none_match, tag):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(body, headers=headers, media_type=JSON_MEDIA_TYPE)
