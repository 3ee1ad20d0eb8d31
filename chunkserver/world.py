"""World: what a world is, whoever keeps it."""

import re
import secrets
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from chunkserver.errors import BadParameter
from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, LOD_MAX
from chunkserver.recipe import WorldRecipe

WORLDS_MAX: Final = 10_000
"""Of one server."""
ID_PATTERN: Final = "^[a-z0-9_-]{1,64}$"
LODS_DEFAULT: Final = 12
VOXEL_SIZE_DEFAULT: Final = 1.0
EPOCH_BYTES: Final = 16

_ID: Final = re.compile(ID_PATTERN.strip("^$"))


def new_epoch() -> str:
    """Return the epoch of a world that begins now."""
    return secrets.token_hex(EPOCH_BYTES)


def now() -> str:
    """Return the time: UTC, ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """One world. A new one gets a new epoch.

    id: what URLs call it.
    recipe: its seed, and the expression tree as canonical JSON.
    recipe_name: what its creator called the recipe: the name of a built-in, or the digest.
    generator: the token of the generator that it was created with; another one makes other terrain.
    voxel_size: metres. Its limits are those of the wire formats, and not checked here.
    lods: levels of detail, 0 to lods - 1.
    chunk_cells: cells a side of a chunk.
    epoch: random hex. Another epoch is another world, under the same id too.
    created: UTC, ISO 8601, to the second.
    revision: how many edits it has taken.

    Raises `BadParameter` for a malformed id, and for lods or chunk_cells that are not built.
    """

    id: str
    recipe: WorldRecipe
    recipe_name: str
    generator: str
    voxel_size: float = VOXEL_SIZE_DEFAULT
    lods: int = LODS_DEFAULT
    chunk_cells: int = CELLS_DEFAULT
    epoch: str = field(default_factory=new_epoch)
    created: str = field(default_factory=now)
    revision: int = 0

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id):
            raise BadParameter(f"id is {self.id[:100]!r}; it must match {ID_PATTERN}", id=self.id)
        if not 1 <= self.lods <= LOD_MAX + 1:
            raise BadParameter(f"lods is {self.lods}; it lies in [1, {LOD_MAX + 1}]", lods=self.lods)
        if self.chunk_cells not in CELLS_BUILT:
            message = f"chunk_cells is {self.chunk_cells}; built are {CELLS_BUILT}"
            raise BadParameter(message, chunk_cells=self.chunk_cells)
