"""What the server says of worlds and recipes, typed and checked: docs/api.md."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final, Literal, Self

from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import (
    CELLS_BUILT,
    COARSER_MAX,
    LOD_MAX,
    POSITION_LOW,
    REVISION_MAX,
    UNITS_PER_SIDE,
    VOXELS_MAX,
    ChunkKey,
    Place,
    Triple,
)

SEED_MAX: Final = (1 << 63) - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """What a world is made of.

    digest: names the expression, the same on every server.
    name: of a built-in recipe; of any other the digest.
    description, parameters: of a built-in recipe; parameters are a JSON Schema each, with its default.
    expression: the expression tree, as it could be posted; empty in a list of recipes.
    """

    digest: str
    name: str
    description: str = ""
    parameters: Mapping[str, Any]
    expression: Mapping[str, Any]

    @classmethod
    def read(cls, json: Json) -> Self:
        """Read it from an answer."""
        digest = json["digest"].text()
        name, description = json.get("name"), json.get("description")
        parameters, expression = json.get("parameters"), json.get("expression")
        return cls(
            digest=digest,
            name=digest if name is None else name.text(),
            description="" if description is None else description.text(),
            parameters={} if parameters is None else parameters.members(),
            expression={} if expression is None else expression.members(),
        )


@dataclass(frozen=True, slots=True)
class FormatOf:
    """One format that chunks are served in."""

    name: str
    extension: str
    media_type: str
    profiles: tuple[str, ...]
    frames: tuple[str, ...]

    @classmethod
    def read(cls, json: Json) -> Self:
        """Read it from an answer."""
        return cls(
            json["name"].text(),
            json["extension"].text(),
            json["media_type"].text(),
            texts(json["profiles"]),
            texts(json["frames"]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Descriptor:
    """Everything to know before asking for a chunk, of a seed or of a world.

    seed: signed, 64 bits.
    generator: the same token means the same bytes.
    voxel_size: metres.
    chunk_cells: cells a side of a chunk, at every LOD.
    lods: levels of detail, 0 (finest) to lods - 1.
    low, high: the world's extent in voxels, both ends included.
    formats, meshers, seams, coarser: what is built.
    geometric_errors: by LOD, how far its surface may be off, in voxels; None if the server does not say.
    """

    seed: int
    recipe: Recipe
    generator: str
    voxel_size: float
    chunk_cells: int
    lods: int
    low: Triple
    high: Triple
    formats: tuple[FormatOf, ...]
    meshers: tuple[str, ...]
    seams: tuple[str, ...]
    coarser: tuple[int, ...]
    geometric_errors: tuple[float, ...] | None = None

    def place(self, key: ChunkKey) -> Place:
        """Return where a chunk of this world is."""
        return Place(key, self.chunk_cells, self.voxel_size)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedDescriptor(Descriptor):
    """The pristine world of a seed: it needs no creation and never changes."""

    kind: Literal["seed"] = "seed"

    @property
    def path(self) -> str:
        """Where it is on the server."""
        return f"/v1/seeds/{self.seed}"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldDescriptor(Descriptor):
    """A world that somebody has created.

    epoch: a world that is deleted and created again has another one.
    revision: how many edits it had taken.
    created: with its time zone, UTC.
    durable: whether it outlives the server.
    answer_seconds: how long a request waits at most, for a worker or for a revision.
    """

    id: str
    epoch: str
    revision: int
    created: datetime
    durable: bool
    answer_seconds: float
    kind: Literal["world"] = "world"

    @property
    def path(self) -> str:
        """Where it is on the server."""
        return f"/v1/worlds/{self.id}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedWorld:
    """One world of the list. recipe: its name, or the digest."""

    id: str
    epoch: str
    revision: int
    created: datetime
    seed: int
    recipe: str
    generator: str

    @classmethod
    def read(cls, json: Json) -> Self:
        """Read it from an answer."""
        return cls(
            **_identity(json),
            seed=json["seed"].decimal(-SEED_MAX - 1, SEED_MAX),
            recipe=json["recipe"].text(),
            generator=json["generator"].text(),
        )


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What HEAD says of a chunk.

    etag: without quotes.
    content_bytes: of the body as it would be sent, in the client's coding; 0 of an empty chunk in the native format.
    revision: of the chunk's own last edit; 0 is pristine.
    """

    etag: str
    content: str
    content_bytes: int
    revision: int


def read_seed(json: Json) -> SeedDescriptor:
    """Read the descriptor of a seed from an answer. Raises `BadAnswer`, which says where, if something is wrong."""
    return SeedDescriptor(**_shared(json))


def read_world(json: Json) -> WorldDescriptor:
    """Read the descriptor of a world from an answer. Raises `BadAnswer`, which says where, if something is wrong."""
    return WorldDescriptor(
        **_shared(json),
        **_identity(json),
        durable=json["durable"].boolean(),
        answer_seconds=json["limits"]["answer_seconds"].number(),
    )


def texts(json: Json) -> tuple[str, ...]:
    """Read a list of strings."""
    return tuple(element.text() for element in json)


def _identity(json: Json) -> dict[str, Any]:
    return {
        "id": json["id"].text(),
        "epoch": json["epoch"].text(),
        "revision": json["revision"].decimal(0, REVISION_MAX),
        "created": _time(json["created"]),
    }


def _time(json: Json) -> datetime:
    try:
        return datetime.fromisoformat(json.text())
    except ValueError:
        json.refuse("a time of ISO 8601")


def _shared(json: Json) -> dict[str, Any]:
    lattice = json["position_lattice"]
    lattice["low"].integer(POSITION_LOW, POSITION_LOW)
    lattice["high"].integer(POSITION_LOW + UNITS_PER_SIDE, POSITION_LOW + UNITS_PER_SIDE)
    cells = json["chunk_cells"].integer(min(CELLS_BUILT), max(CELLS_BUILT))
    lods = json["lods"].integer(1, LOD_MAX + 1)
    return {
        "seed": json["seed"].decimal(-SEED_MAX - 1, SEED_MAX),
        "recipe": Recipe.read(json["recipe"]),
        "generator": json["generator"].text(),
        "voxel_size": json["voxel_size"].number(),
        "chunk_cells": cells,
        "lods": lods,
        "low": _point(json["bounds"]["min"]),
        "high": _point(json["bounds"]["max"]),
        "formats": tuple(FormatOf.read(row) for row in json["formats"]),
        "meshers": texts(json["meshers"]),
        "seams": texts(json["seams"]),
        "coarser": tuple(mask.integer(0, COARSER_MAX) for mask in json["coarser"]),
        "geometric_errors": _errors(json.get("geometric_errors"), lods),
    }


def _errors(json: Json | None, lods: int) -> tuple[float, ...] | None:
    if json is None:
        return None
    errors = tuple(error.number() for error in json)
    if len(errors) != lods or min(errors) < 0:
        json.refuse(f"{lods} numbers, none of them negative")
    return errors


def _point(json: Json) -> Triple:
    x, y, z = (json[axis].integer(-VOXELS_MAX, VOXELS_MAX) for axis in range(3))
    return x, y, z
