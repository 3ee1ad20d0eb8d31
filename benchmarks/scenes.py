"""Which chunks are measured: kinds of place in a world, each with more different chunks than any rotation needs."""

import itertools
import math
import random
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from chunkserver.field import sample
from chunkserver.grid import CELLS_DEFAULT, ChunkKey, ChunkShape
from chunkserver.mesh import Content, Mesh
from chunkserver.mesher import extract
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples
from chunkserver.wire import Placement

SEED: Final = 42
SHAPE: Final = ChunkShape()
VOXEL_SIZE: Final = 1.0
PLANET_RADIUS: Final = 200.0


class Scene(NamedTuple):
    """One kind of place: the chunks of `keys` whose content is `content`."""

    name: str
    recipe: str
    content: Content
    keys: tuple[ChunkKey, ...]


@dataclass(frozen=True, slots=True)
class Ready:
    """One chunk and everything that a stage of it may start from."""

    request: ChunkRequest
    placement: Placement
    samples: Samples
    mesh: Mesh


def layers(heights: Iterable[int], side: int) -> tuple[ChunkKey, ...]:
    """Return the keys, at the finest level, of square layers of `side` * `side` chunks around the origin."""
    across = range(-side // 2, side - side // 2)
    return tuple(ChunkKey(0, x, y, z) for y, x, z in itertools.product(heights, across, across))


def _crust() -> tuple[ChunkKey, ...]:
    """Return the keys of the chunks whose middle is at most half a chunk away from the planet's sea level."""
    reach = math.ceil(PLANET_RADIUS / CELLS_DEFAULT) + 1
    keys = [ChunkKey(0, *place) for place in itertools.product(range(-reach, reach), repeat=3)]
    return tuple(key for key in keys if abs(_middle_radius(key) - PLANET_RADIUS) <= CELLS_DEFAULT / 2)


def _middle_radius(key: ChunkKey) -> float:
    return math.hypot(key.x + 0.5, key.y + 0.5, key.z + 0.5) * CELLS_DEFAULT


# The relief of `terrain` and `hills` is 24 voxels up and down at most: within chunks -1 and 0.
SCENES: Final = {
    scene.name: scene
    for scene in (
        Scene("terrain surface", "terrain", "surface", layers((-1, 0), 12)),
        Scene("terrain underground", "terrain", "surface", layers(range(-8, -2), 6)),
        Scene("hills", "hills", "surface", layers((-1, 0), 12)),
        Scene("planet", "planet", "surface", _crust()),
        Scene("empty air", "terrain", "air", layers((3, 4), 8)),
    )
}


AROUND: Final = tuple(ChunkKey(0, *place) for place in itertools.product(range(-2, 2), repeat=3))
"""The 64 chunks around the origin."""


def prepare(scene: Scene, count: int) -> list[Ready]:
    """Return `count` different chunks of `scene`, the same ones in every run, in an order without pattern."""
    return choose(WorldRecipe(SEED, builtin(scene.recipe)), scene.keys, count, scene.content)


def choose(
    recipe: WorldRecipe, keys: Iterable[ChunkKey], count: int, content: Content, cells: int = CELLS_DEFAULT
) -> list[Ready]:
    """Return `count` different chunks among `keys` whose content is `content`, in an order without pattern.

    Raises ValueError if there are fewer.
    """
    shuffled = list(keys)
    random.Random(SEED).shuffle(shuffled)
    found = (chunk for chunk in (make_ready(recipe, key, cells) for key in shuffled) if chunk.mesh.content == content)
    chunks = list(itertools.islice(found, count))
    if len(chunks) < count:
        raise ValueError(f"of {len(shuffled)} chunks {len(chunks)} have the content {content}; {count} are wanted")
    return chunks


def make_ready(recipe: WorldRecipe, key: ChunkKey, cells: int = CELLS_DEFAULT) -> Ready:
    """Return one chunk with everything that a stage of it may start from."""
    samples = sample(recipe, key, ChunkShape(cells))
    placement = Placement(key, cells, VOXEL_SIZE)
    return Ready(ChunkRequest(recipe, key, cells), placement, samples, extract(samples))


def triangles(chunks: Iterable[Ready]) -> float:
    """Return the mean number of triangles."""
    counts = [len(chunk.mesh.triangles) for chunk in chunks]
    return sum(counts) / len(counts)
