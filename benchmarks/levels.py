"""Milliseconds per chunk, from its key to its bytes: at LOD 12, beside finer levels of the same world.

All are chunks with a surface, in the native format: around the ground of `terrain` and `hills`, and all over a `planet`
as large as the Earth. What a level does not show is not on its tape, so coarse chunks are to cost no more than fine
ones. How many times the cost of LOD 12 it is stands behind each other level.
"""

import math
import random
from collections.abc import Callable, Iterator
from typing import Final

from benchmarks.measure import MS, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SEED, choose, triangles
from chunkserver.grid import CELLS_DEFAULT, ChunkKey
from chunkserver.pipeline import build_chunk
from chunkserver.recipe import WorldRecipe, builtin

LEVELS: Final = (12, 0, 4, 8)
"""The first is ours, the others are what it is beside."""
PLANET_RADIUS: Final = 6_400_000.0
ACROSS: Final = 100
"""Chunks from the origin to where ground is drawn, at most."""
DRAWN: Final = 64
"""Keys that are drawn for each chunk that is wanted: many of them miss the surface."""

Draw = Callable[[int, random.Random], ChunkKey]


def _ground(lod: int, draw: random.Random) -> ChunkKey:
    return ChunkKey(lod, draw.randrange(-ACROSS, ACROSS), draw.choice((-1, 0)), draw.randrange(-ACROSS, ACROSS))


def _planet(lod: int, draw: random.Random) -> ChunkKey:
    """Return a chunk that sea level crosses: evenly spread over the ball."""
    direction = [draw.gauss(0, 1) for _ in range(3)]
    chunks = PLANET_RADIUS / (CELLS_DEFAULT << lod) / math.hypot(*direction)
    x, y, z = (math.floor(component * chunks) for component in direction)
    return ChunkKey(lod, x, y, z)


WORLDS: Final[dict[str, tuple[str, Draw]]] = {
    "terrain": (builtin("terrain"), _ground),
    "hills": (builtin("hills"), _ground),
    "planet": (builtin("planet", radius=PLANET_RADIUS), _planet),
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per world: milliseconds per chunk at each level, and triangles at the first."""
    for name, (source, place) in WORLDS.items():
        recipe, draw = WorldRecipe(SEED, source), random.Random(SEED)
        chunks = {}
        for lod in LEVELS:
            keys = dict.fromkeys(place(lod, draw) for _ in range(DRAWN * scale.chunks))
            chunks[f"LOD {lod}"] = choose(recipe, keys, scale.chunks, "surface")
        candidates = {
            level: timed(lambda chunk: build_chunk(chunk.request), of_level, MS) for level, of_level in chunks.items()
        }
        ours = next(iter(chunks.values()))
        count = Figure("triangles", "a chunk", (triangles(ours),))
        yield Line(name, (count, *beside_first(in_turns(candidates, scale.rounds), "ms")))
