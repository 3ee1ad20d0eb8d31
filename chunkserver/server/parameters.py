"""What may stand in a URL. The routes declare it with these types; whatever else is sent is refused by name."""

import re
from collections.abc import Iterable
from typing import Annotated, Any, Final

from fastapi import Depends, Header, Path, Request
from fastapi.openapi.models import Example
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, WithJsonSchema
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticCustomError

from chunkserver.errors import BadParameter
from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, LATTICE_MAX, LOD_MAX, MASK_MAX, ChunkKey
from chunkserver.mesher import MESHER_DEFAULT, MESHERS
from chunkserver.pipeline import SEAM_DEFAULT, SEAMS_BUILT, ChunkRequest, check_request
from chunkserver.recipe import BUILTINS, RECIPE_DEFAULT, WorldRecipe
from chunkserver.server.posted import DIGEST_PATTERN, PostedRecipes, source_of
from chunkserver.wire import FORMATS, Encoding
from chunkserver.world import ID_PATTERN

DECIMAL: Final = "0|-?[1-9][0-9]{0,18}"
"""The one way to write a 64-bit integer, so that a resource has one URL: no plus sign, leading zero or minus zero."""
TOKEN: Final = "^[0-9a-f]{1,64}$"
"""Of a generator, or of an epoch."""

REVISION_MAX: Final = (1 << 63) - 1

_MIDDLE: Final = ChunkKey(0, 0, 0, 0)
_COORDINATES: Final = LATTICE_MAX // min(CELLS_BUILT)


def _integer(text: Any) -> int:
    if not isinstance(text, str) or not re.fullmatch(DECIMAL, text):
        raise PydanticCustomError("decimal", "must be a decimal integer in its shortest form, such as -3")
    return int(text)


def _examples(*values: object) -> dict[str, Example]:
    return {str(value): {"value": value} for value in values}


def _one_of(names: Iterable[str]) -> dict[str, JsonValue]:
    return {"enum": [*sorted(set(names))]}


# Ranges are only described here: `check_key`, `check_request` and `WorldRecipe` hold them for every caller.
Decimal = Annotated[int, BeforeValidator(_integer)]
Seed = Annotated[
    Decimal,
    WithJsonSchema({"type": "string", "pattern": f"^(?:{DECIMAL})$"}),
    Path(description="The world's seed: a signed 64-bit integer.", openapi_examples=_examples("42")),
]
WorldId = Annotated[
    str, Path(description="The world's id.", pattern=ID_PATTERN, openapi_examples=_examples("my-world"))
]
Revision = Annotated[
    Decimal,
    Field(ge=0, le=REVISION_MAX),
    WithJsonSchema({"type": "integer", "minimum": 0, "maximum": REVISION_MAX}),
]
Lod = Annotated[
    Decimal,
    WithJsonSchema({"type": "integer", "minimum": 0, "maximum": LOD_MAX}),
    Path(description="Level of detail, 0 is finest; a step is 2^lod voxels.", openapi_examples=_examples(0)),
]
Coordinate = Annotated[
    Decimal,
    WithJsonSchema({"type": "integer", "minimum": -_COORDINATES, "maximum": _COORDINATES - 1}),
    Path(
        description=f"Chunk coordinate. The range is that of LOD 0 and {min(CELLS_BUILT)} cells a side; it halves with "
        "each LOD, and with each doubling of the cells.",
        openapi_examples=_examples(0),
    ),
]
IfNoneMatch = Annotated[
    tuple[str, ...],
    Header(
        alias="If-None-Match",
        description="Entity tags that the client has. If the answer's is among them, or with `*`, it is a 304.",
        openapi_examples={"any": {"value": ["*"]}, "two": {"value": ['"01ab"', 'W/"23cd"']}},
    ),
]


RECIPE_NAMES: Final[dict[str, JsonValue]] = {"anyOf": [_one_of(BUILTINS), {"pattern": DIGEST_PATTERN}]}
"""The schema of a recipe's name in a URL."""


class NoQuery(BaseModel):
    """Of a resource without parameters."""

    model_config = ConfigDict(extra="forbid")


class SeedQuery(NoQuery):
    """Parameters of everything below a seed."""

    recipe: str = Field(
        RECIPE_DEFAULT,
        description="Which world the seed is of: the name of a built-in recipe, or the digest of any.",
        json_schema_extra=RECIPE_NAMES,
    )


class ChunkQuery(NoQuery):
    """Parameters of a chunk, of a seed or of a world."""

    mesher: str = Field(
        MESHER_DEFAULT,
        description="How the surface is made.",
        json_schema_extra=_one_of(MESHERS),
    )
    coarser: Annotated[Decimal, WithJsonSchema({"type": "integer", "minimum": 0, "maximum": MASK_MAX})] = Field(
        0,
        description="Mask of the faces whose neighbour is one LOD coarser, -x +x -y +y -z +z = 1 2 4 8 16 32: the "
        "chunk is closed against them. Other than 0 only with `seam=transitions`.",
    )
    seam: str = Field(
        SEAM_DEFAULT,
        description="How borders to coarser neighbours are closed.",
        json_schema_extra=_one_of(SEAMS_BUILT),
    )
    g: Annotated[str, Field(pattern=TOKEN)] | SkipJsonSchema[None] = Field(
        None,
        description="The generator token of the descriptor. Another one than the current is a 410. With it a seed's "
        "chunk may be kept for ever; a world's, with `epoch` and `revision`.",
    )


class NativeQuery(ChunkQuery):
    """Parameters of a chunk in the native format."""

    profile: str = Field(
        Encoding().profile,
        description="Native format only: how positions and normals are written.",
        json_schema_extra=_one_of(name for row in FORMATS.values() for name in row.profiles),
    )


class GlbQuery(ChunkQuery):
    """Parameters of a chunk as GLB."""

    frame: str = Field(
        Encoding().frame,
        description="GLB only: where the node puts the chunk. `chunk`: its low corner is the origin.",
        json_schema_extra=_one_of(name for row in FORMATS.values() for name in row.frames),
    )


class AnyQuery(GlbQuery, NativeQuery):
    """Parameters of a chunk whose format `Accept` chooses."""


class SeedChunkQuery(ChunkQuery, SeedQuery):
    """Parameters of a seed's chunk."""


class SeedNativeQuery(NativeQuery, SeedChunkQuery):
    """Parameters of a seed's chunk in the native format."""


class SeedGlbQuery(GlbQuery, SeedChunkQuery):
    """Parameters of a seed's chunk as GLB."""


class SeedAnyQuery(AnyQuery, SeedChunkQuery):
    """Parameters of a seed's chunk whose format `Accept` chooses."""


class WorldChunkQuery(ChunkQuery):
    """Parameters of a world's chunk."""

    epoch: Annotated[str, Field(pattern=TOKEN)] | SkipJsonSchema[None] = Field(
        None, description="The epoch of the world's descriptor. Another one than the current is a 410."
    )
    revision: Revision | SkipJsonSchema[None] = Field(
        None,
        description="A revision of the world that the client knows. With `g` and `epoch` the answer may be kept for "
        "ever, unless the chunk was edited since. One that is yet to come is a 404.",
    )
    min_revision: Revision = Field(
        0, description="Wait until the world has this revision. A 503 if it does not come in time."
    )


class WorldNativeQuery(NativeQuery, WorldChunkQuery):
    """Parameters of a world's chunk in the native format."""


class WorldGlbQuery(GlbQuery, WorldChunkQuery):
    """Parameters of a world's chunk as GLB."""


class WorldAnyQuery(AnyQuery, WorldChunkQuery):
    """Parameters of a world's chunk whose format `Accept` chooses."""


async def refuse_repeats(request: Request) -> None:
    """Raise `BadParameter` for a query parameter that is given more than once: one of the two would be ignored."""
    seen: set[str] = set()
    for name, value in request.query_params.multi_items():
        if name in seen:
            raise BadParameter(f"{name} is given more than once", **{name: value})
        seen.add(name)


def pristine(seed: int, recipe: str, posted: PostedRecipes) -> WorldRecipe:
    """Return the pristine world of `seed` and the recipe named `recipe`. Raises `BadRecipe` or `UnknownRecipe`."""
    return WorldRecipe(seed, source_of(recipe, posted))


async def _key(lod: Lod, x: Coordinate, y: Coordinate, z: Coordinate) -> ChunkKey:
    return ChunkKey(lod, x, y, z)


KeyOfUrl = Annotated[ChunkKey, Depends(_key)]


def chunk_template(
    recipe: WorldRecipe,
    query: ChunkQuery,
    encoding: Encoding,
    *,
    cells: int = CELLS_DEFAULT,
    voxel_size: float = 1.0,
    revision: int = 0,
) -> ChunkRequest:
    """Return what a query asks for, of the chunk in the middle. Raises `BadParameter` if it is not built."""
    request = ChunkRequest(
        recipe,
        _MIDDLE,
        cells=cells,
        voxel_size=voxel_size,
        mesher=query.mesher,
        coarser=query.coarser,
        seam=query.seam,
        revision=revision,
        encoding=encoding,
    )
    check_request(request)
    return request


def encoding_of(format_name: str, query: AnyQuery) -> Encoding:
    """Return the encoding that `query` asks of a format. Raises `BadParameter` for what does not apply to it.

    A field applies if the format has a choice in it.
    """
    row = FORMATS[format_name]
    for name, built in (("profile", row.profiles), ("frame", row.frames)):
        if name in query.model_fields_set and len(built) == 1:
            given = getattr(query, name)
            raise BadParameter(f"{name} does not apply to format {format_name}", **{name: given, "format": format_name})
    return Encoding(format_name, query.profile, query.frame)
