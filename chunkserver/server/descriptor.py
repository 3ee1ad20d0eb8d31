"""What clients must know before they ask for a chunk, of a seed or of a world."""

import json
from collections.abc import Sequence
from typing import Any, Final, Literal

from pydantic import BaseModel, Field

from chunkserver.grid import CELLS_DEFAULT, LATTICE_MAX, LOD_MAX, MASK_MAX, POSITION_HIGH, POSITION_LOW, ChunkShape
from chunkserver.mesher import MESHERS
from chunkserver.pipeline import SEAMS_BUILT, generator
from chunkserver.recipe import WorldRecipe
from chunkserver.server.parameters import DECIMAL, TOKEN
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


class Descriptor(BaseModel):
    """What a seed and a world have in common."""

    seed: str = Field(pattern=f"^(?:{DECIMAL})$", description="A decimal string: JavaScript would round the number.")
    recipe: RecipeOf
    generator: str = Field(pattern=TOKEN, description="The same token means the same bytes. Goes into `g`.")
    voxel_size: float = Field(default=VOXEL_SIZE, description="Metres.")
    chunk_cells: int = Field(default=CELLS_DEFAULT, description="Cells a side of a chunk, at every LOD.")
    lods: int = Field(default=LOD_MAX + 1, description="Levels of detail, 0 (finest) to lods - 1.")
    geometric_errors: list[float] | None = Field(
        description="By LOD, voxels, above 0: how far the surface is off, within a factor of 2. Null if not known yet."
    )
    bounds: Bounds
    axes: Axes
    position_lattice: PositionLattice
    urls: Urls
    formats: list[FormatOf]
    meshers: list[str]
    seams: list[str]
    coarser: list[int] = Field(description="The masks that are built; at the last level only 0.")


def members(
    recipe: WorldRecipe,
    name: str,
    urls: Urls,
    errors: Sequence[float] | None,
    cells: int = CELLS_DEFAULT,
    lods: int = LOD_MAX + 1,
) -> dict[str, Any]:
    """Return the members of a `Descriptor` that follow from the recipe, what it is called, cells and levels.

    errors: the geometric error of each level there can be, voxels; None if it is not known.
    """
    return {
        "seed": str(recipe.seed),
        "recipe": RecipeOf(name=name, digest=recipe.digest, expression=json.loads(recipe.source)),
        "generator": generator(recipe),
        "chunk_cells": cells,
        "lods": lods,
        "geometric_errors": None if errors is None else list(errors[:lods]),
        "bounds": Bounds(min=(-LATTICE_MAX,) * 3, max=(LATTICE_MAX,) * 3),
        "axes": Axes(),
        "position_lattice": PositionLattice(units_per_voxel=ChunkShape(cells).units_per_cell),
        "urls": urls,
        "formats": [FormatOf(**row._asdict()) for row in FORMATS.values()],
        "meshers": sorted(MESHERS),
        "seams": sorted(SEAMS_BUILT),
        "coarser": list(range(MASK_MAX + 1 if lods > 1 else 1)),
    }
