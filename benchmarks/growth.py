"""Milliseconds per chunk at LOD 0: what a chunk costs the more surface, and the more recipe, it has.

- Cells: chunks of 16, 32 and 64 cells with a surface, from `terrain` between 64 voxels below its mean ground and 32
  above. They are sorted by their triangles and cut into quarters.
- Nodes: recipes of so many nodes, spheres and boxes within 64 voxels of the origin and the `min` that joins them; the
  64 chunks of 32 cells around the origin, with a surface or without.
"""

import random
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from benchmarks.measure import MS, Figure, Line, Scale, figures, in_turns, timed
from benchmarks.scenes import AROUND, SEED, Ready, choose, layers, make_ready, triangles
from chunkserver.field import sample
from chunkserver.grid import CELLS_BUILT
from chunkserver.mesher import extract
from chunkserver.pipeline import build_chunk
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.recipe.builder import box, minimum, sphere
from chunkserver.recipe.node import Node

QUARTERS: Final = ("least surface", "less surface", "more surface", "most surface")
DEPTH_VOXELS: Final = 64
HEIGHT_VOXELS: Final = 32
SIDE: Final = 12
"""Chunks a side of a layer, whatever their size."""
NODES: Final = (5, 11, 25, 51, 101, 199)
REACH_VOXELS: Final = 64.0
RADII: Final = (4.0, 16.0)
"""Of the shapes, least and most, voxels."""

STAGES: Final[dict[str, Callable[[Ready], object]]] = {
    "field": lambda chunk: sample(chunk.request.recipe, chunk.request.key, chunk.samples.shape),
    "mesh, normals": lambda chunk: extract(chunk.samples),
    "whole chunk, native": lambda chunk: build_chunk(chunk.request),
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per quarter of each chunk size, and one per number of nodes."""
    terrain = WorldRecipe(SEED, builtin("terrain"))
    for cells in CELLS_BUILT:
        keys = layers(range(-DEPTH_VOXELS // cells, -(-HEIGHT_VOXELS // cells)), SIDE)
        chunks = sorted(choose(terrain, keys, scale.chunks, "surface", cells), key=lambda chunk: triangles([chunk]))
        size = -(-len(chunks) // len(QUARTERS))
        parts = {f"{cells} cells, {name}": chunks[i * size : (i + 1) * size] for i, name in enumerate(QUARTERS)}
        yield from _lines({name: part for name, part in parts.items() if part}, scale.rounds)
    for count in NODES:
        recipe = WorldRecipe(SEED, canonical(shapes(count)))
        chunks = [make_ready(recipe, key) for key in AROUND[: scale.chunks]]
        yield from _lines({f"{count} nodes": chunks}, scale.rounds)


def _lines(parts: dict[str, list[Ready]], rounds: int) -> Iterator[Line]:
    """Yield a line per part: milliseconds per chunk for each stage. All parts take their turns in each round."""
    candidates = {(part, stage): timed(STAGES[stage], parts[part], MS) for part in parts for stage in STAGES}
    results = in_turns(candidates, rounds)
    for part, chunks in parts.items():
        count = Figure("triangles", "a chunk", (triangles(chunks),))
        yield Line(part, (count, *figures({stage: results[part, stage] for stage in STAGES}, "ms")))


def shapes(count: int) -> Node:
    """Return a recipe of `count` nodes, an odd number: every other one is a shape, the rest joins two each."""
    draw = random.Random(SEED)
    return _joined([_shape(draw, number) for number in range(count // 2 + 1)])


def _shape(draw: random.Random, number: int) -> Node:
    center = tuple(draw.uniform(-REACH_VOXELS, REACH_VOXELS) for _ in range(3))
    if number % 2:
        return box(center=center, half_extents=tuple(draw.uniform(*RADII) for _ in range(3)))
    return sphere(center=center, radius=draw.uniform(*RADII))


def _joined(nodes: Sequence[Node]) -> Node:
    """Return a balanced tree: recipes are at most 64 nodes deep."""
    half = len(nodes) // 2
    return nodes[0] if len(nodes) == 1 else minimum(_joined(nodes[:half]), _joined(nodes[half:]))
