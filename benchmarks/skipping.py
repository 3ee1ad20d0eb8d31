"""Microseconds per chunk, beside the same with every sample worked out: no proof that a chunk is empty, no skipping.

- Proved air: the proof alone, beside the samples alone, of chunks of `terrain` that are all air.
- Near the surface: the samples that a mesh depends on, beside all of them, of chunks with a surface; the time that it
  takes to find out which those are included. `floating-islands` is mostly air within its chunks too; of `planet`,
  around its sea level, too little is settled, and all is sampled.
- Fly-through: whole chunks in the native format, of all that a viewer near the ground asks for on its way: the nearer,
  the finer, neighbours at most one level apart, LODs 0 to 5, 2 km around. Most of them are air or rock. The bytes are
  the same with and without.
"""

import itertools
import math
import random
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from benchmarks.measure import US, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import PLANET_RADIUS, SCENES, SEED, SHAPE, VOXEL_SIZE, Scene, layers, prepare
from chunkserver.field import prove, sample, sample_near_surface
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import ChunkKey
from chunkserver.mesher import extract
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Placement, encode

Place = tuple[float, float, float]

ROOT_LOD: Final = 5
STEPS: Final = 16
"""Places on the way."""
STEP_VOXELS: Final = 16.0
ALTITUDE_VOXELS: Final = 20.0
CHUNKS: Final = 4
"""Times the chunks of other rotations: most are empty."""

ISLANDS: Final = Scene("floating-islands", "floating-islands", "surface", layers((-1, 0, 7, 8), 24))
"""Nine in ten of these chunks are air."""


class Flight(NamedTuple):
    """A way over one recipe's world: where the viewer is at each step."""

    recipe: str
    place: Callable[[int], Place]


def _over_ground(step: int) -> Place:
    return step * STEP_VOXELS, ALTITUDE_VOXELS, step * STEP_VOXELS / 2


def _around_planet(step: int) -> Place:
    radius = PLANET_RADIUS + ALTITUDE_VOXELS
    angle = step * STEP_VOXELS / radius
    return radius * math.sin(angle), radius * math.cos(angle), 0.0


FLIGHTS: Final = (Flight("terrain", _over_ground), Flight("hills", _over_ground), Flight("planet", _around_planet))


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for chunks of air, two for chunks with a surface, one per flight: microseconds per chunk."""
    air = [chunk.request for chunk in prepare(SCENES["empty air"], scale.chunks)]
    yield _line("proved air", air, _prove, _sample, 100.0, scale.rounds)
    for scene in (ISLANDS, SCENES["planet"]):
        ground = [chunk.request for chunk in prepare(scene, scale.chunks)]
        yield _line(f"near the surface, {scene.name}", ground, _sample_near, _sample, 0.0, scale.rounds)
    for flight in FLIGHTS:
        requests = _on_the_way(flight, CHUNKS * scale.chunks)
        empty = sum(build_chunk(request).content != "surface" for request in requests) / len(requests) * 100
        yield _line(f"fly-through, {flight.recipe}", requests, build_chunk, build_sampled, empty, scale.rounds)


def _line(
    subject: str,
    requests: list[ChunkRequest],
    ours: Callable[[ChunkRequest], object],
    without: Callable[[ChunkRequest], object],
    empty: float,
    rounds: int,
) -> Line:
    candidates = {"chunkserver": timed(ours, requests, US), "every sample": timed(without, requests, US)}
    return Line(subject, (Figure("empty", "%", (empty,)), *beside_first(in_turns(candidates, rounds), "us")))


def _prove(request: ChunkRequest) -> object:
    return prove(request.recipe, request.key, SHAPE)


def _sample_near(request: ChunkRequest) -> object:
    return sample_near_surface(request.recipe, request.key, SHAPE)


def _sample(request: ChunkRequest) -> object:
    return sample(request.recipe, request.key, SHAPE)


def build_sampled(request: ChunkRequest) -> bytes:
    """Return the bytes of a chunk of 32 cells in the native format, which is sampled whether it is empty or not."""
    mesh = extract(sample(request.recipe, request.key, SHAPE))
    error = geometric_error(request.recipe, request.key.lod)
    return encode(mesh, Placement(request.key, SHAPE.cells, VOXEL_SIZE, geometric_error=error * VOXEL_SIZE))


def _on_the_way(flight: Flight, count: int) -> list[ChunkRequest]:
    """Return so many different chunks of those that a viewer asks for on its way, in an order without pattern."""
    keys = dict.fromkeys(key for step in range(STEPS) for key in cut(flight.place(step)))
    recipe = WorldRecipe(SEED, builtin(flight.recipe))
    return [ChunkRequest(recipe, key) for key in random.Random(SEED).sample(list(keys), count)]


def cut(viewer: Place) -> Iterator[ChunkKey]:
    """Yield the keys of an octree's leaves around a viewer: a chunk is split if it is nearer than it is wide."""
    side = SHAPE.cells << ROOT_LOD
    middle = [math.floor(coordinate / side) for coordinate in viewer]
    for offset in itertools.product((-1, 0, 1), repeat=3):
        x, y, z = (a + b for a, b in zip(middle, offset, strict=True))
        yield from _leaves(ChunkKey(ROOT_LOD, x, y, z), viewer)


def _leaves(key: ChunkKey, viewer: Place) -> Iterator[ChunkKey]:
    side = SHAPE.cells << key.lod
    distance = max(
        max(low - place, place - low - side) for low, place in zip(key.low_corner(SHAPE.cells), viewer, strict=True)
    )
    if key.lod == 0 or distance >= side:
        yield key
        return
    for x, y, z in itertools.product((0, 1), repeat=3):
        yield from _leaves(ChunkKey(key.lod - 1, 2 * key.x + x, 2 * key.y + y, 2 * key.z + z), viewer)
