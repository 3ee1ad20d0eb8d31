"""The descriptor of a seed's pristine world: everything that a client must know before it asks for a chunk."""

import json
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from chunkserver.errors import BadParameter, BadRecipe
from chunkserver.grid import CELLS_DEFAULT, LATTICE_MAX, LOD_MAX, POSITION_HIGH, POSITION_LOW, ChunkShape
from chunkserver.mesher import MESHERS
from chunkserver.pipeline import SEAMS_BUILT, generator
from chunkserver.recipe import WorldRecipe
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.parameters import (
    COARSER_BUILT,
    DECIMAL,
    GENERATOR_TOKEN,
    Seed,
    SeedQuery,
    refuse_repeats,
    world,
)
from chunkserver.server.problems import UnknownRecipe
from chunkserver.server.service import ServiceOfApp
from chunkserver.wire import FORMATS

VOXEL_SIZE: Final = 1.0

Voxels = tuple[int, int, int]


class RecipeOf(BaseModel):
    """What the world is made of."""

    name: str = Field(description="As the URL gives it: a name or a digest.")
    digest: str = Field(description="Names the expression, without the seed.")
    expression: dict[str, Any] = Field(description="The expression tree: every default written out.")


class Bounds(BaseModel):
    """The extent of the world in voxels, both ends included. Chunks that reach beyond it are refused."""

    min: Voxels
    max: Voxels


class Axes(BaseModel):
    """Which way is which."""

    up: Literal["+y"] = "+y"
    handedness: Literal["right"] = "right"
    winding: Literal["counter-clockwise seen from the air"] = "counter-clockwise seen from the air"


class PositionLattice(BaseModel):
    """Vertices have integer positions: (position - low) * 2^lod / units_per_voxel voxels from the low corner."""

    low: int = Field(default=POSITION_LOW, description="Position of the chunk's low face.")
    high: int = Field(default=POSITION_HIGH, description="Position of its high face.")
    units_per_voxel: int = Field(description="At LOD 0; halved at each LOD above.")


class FormatOf(BaseModel):
    """One format that chunks are served in."""

    name: str
    extension: str
    media_type: str
    profiles: list[str]
    frames: list[str]


class Urls(BaseModel):
    """URL templates (RFC 6570, level 1), relative to the server."""

    chunk: str = Field(description="A chunk; `extension` is one of a format's, with its dot, or nothing.")
    chunk_immutable: str = Field(description="The same, for ever: it names the generator.")


class SeedDescriptor(BaseModel):
    """A seed's pristine world."""

    seed: str = Field(pattern=f"^(?:{DECIMAL})$", description="A decimal string: JavaScript would round the number.")
    recipe: RecipeOf
    generator: str = Field(pattern=GENERATOR_TOKEN, description="The same token means the same bytes. Goes into `g`.")
    voxel_size: float = Field(default=VOXEL_SIZE, description="Metres.")
    chunk_cells: int = Field(default=CELLS_DEFAULT, description="Cells a side of a chunk, at every LOD.")
    lods: int = Field(default=LOD_MAX + 1, description="Levels of detail, 0 (finest) to lods - 1.")
    bounds: Bounds
    axes: Axes
    position_lattice: PositionLattice
    urls: Urls
    formats: list[FormatOf]
    meshers: list[str]
    seams: list[str]
    coarser: list[int] = Field(description="The masks that are built.")


router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], tags=["seeds"])


@router.api_route(
    "/v1/seeds/{seed}",
    methods=RESOURCE,
    summary="The descriptor of a seed's pristine world",
    responses={
        200: {"description": "The descriptor.", "headers": {"Cache-Control": header("Always `no-cache`.")}},
        **problem_responses(BadParameter, BadRecipe, UnknownRecipe),
    },
)
async def seed_descriptor(
    seed: Seed, query: Annotated[SeedQuery, Query()], service: ServiceOfApp, response: Response
) -> SeedDescriptor:
    """Everything that a client must know before it asks for a chunk. Nothing has to be created first."""
    response.headers["Cache-Control"] = "no-cache"
    return describe(world(seed, query.recipe, service.posted), query.recipe)


def describe(recipe: WorldRecipe, name: str) -> SeedDescriptor:
    """Return the descriptor of the pristine world `recipe`, whose recipe is called `name`."""
    token = generator(recipe)
    chunk = f"/v1/seeds/{recipe.seed}/chunks/{{lod}}/{{x}}/{{y}}/{{z}}{{extension}}?recipe={name}"
    return SeedDescriptor(
        seed=str(recipe.seed),
        recipe=RecipeOf(name=name, digest=recipe.digest, expression=json.loads(recipe.source)),
        generator=token,
        bounds=Bounds(min=(-LATTICE_MAX,) * 3, max=(LATTICE_MAX,) * 3),
        axes=Axes(),
        position_lattice=PositionLattice(units_per_voxel=ChunkShape(CELLS_DEFAULT).units_per_cell),
        urls=Urls(chunk=chunk, chunk_immutable=f"{chunk}&g={token}"),
        formats=[FormatOf(**row._asdict()) for row in FORMATS.values()],
        meshers=sorted(MESHERS),
        seams=sorted(SEAMS_BUILT),
        coarser=list(COARSER_BUILT),
    )
