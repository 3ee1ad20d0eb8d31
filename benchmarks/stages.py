"""Milliseconds per chunk of 32 cells at LOD 0, in one thread.

Each stage starts from what the one before it made for all chunks of the rotation (64 chunks have 11 MB of samples), so
it reads its input from memory. In the whole chunk, which ends as native bytes, that input is still in the cache.
"""

from collections.abc import Callable, Iterator
from typing import Final

from benchmarks.measure import MS, Figure, Line, Scale, figures, in_turns, timed
from benchmarks.scenes import SCENES, SHAPE, Ready, prepare, triangles
from chunkserver.field import sample
from chunkserver.mesher import extract
from chunkserver.pipeline import build_chunk
from chunkserver.wire import Encoding, encode

GLB: Final = Encoding("glb")

STAGES: Final[dict[str, Callable[[Ready], object]]] = {
    "field": lambda chunk: sample(chunk.request.recipe, chunk.request.key, SHAPE),
    "mesh, normals": lambda chunk: extract(chunk.samples),
    "encode native": lambda chunk: encode(chunk.mesh, chunk.placement),
    "encode GLB": lambda chunk: encode(chunk.mesh, chunk.placement, GLB),
    "whole chunk, native": lambda chunk: build_chunk(chunk.request),
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per scene: milliseconds per chunk for each stage and for all of `build_chunk`."""
    for scene in SCENES.values():
        chunks = prepare(scene, scale.chunks)
        rounds = in_turns({name: timed(stage, chunks, MS) for name, stage in STAGES.items()}, scale.rounds)
        count = Figure("triangles", "a chunk", (triangles(chunks),))
        yield Line(scene.name, (count, *figures(rounds, "ms")))
