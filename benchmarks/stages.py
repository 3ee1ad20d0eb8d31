"""Milliseconds per chunk of 32 cells at LOD 0, in one thread.

Each stage starts from what the one before it made for all chunks of the rotation (64 chunks have 11 MB of samples), so
it reads its input from memory. In the whole chunk, which ends as native bytes, that input is still in the cache.

- Proof: the bounds that tell whether the chunk is empty. Where they tell it, nothing else is done but to encode.
- Field: what a chunk takes, samples near the surface where that pays. Every sample: the same with none left out.
- Noise alone: the instructions of the recipe that are noise, and what moves their points, for every sample: the floor
  of a field of which nothing is left out. Samples read: `density.max()` by NumPy, the floor of what looks at samples.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from benchmarks.measure import MS, Figure, Line, Scale, figures, in_turns, timed
from benchmarks.scenes import SCENES, SHAPE, Ready, prepare, triangles
from chunkserver.field import ops, prove, sample, sample_near_surface
from chunkserver.field.flatten import flatten
from chunkserver.field.points import run_box
from chunkserver.field.tape import Tape
from chunkserver.mesher import extract
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe
from chunkserver.wire import Encoding, encode

GLB: Final = Encoding("glb")

MOVES_OR_NOISE: Final = [*range(ops.COORDINATE_LAST + 1), *range(ops.RANDOM, ops.CELLULAR3 + 1)]


def noise_alone(request: ChunkRequest) -> object:
    """Run what is noise of a chunk's tape, at every sample."""
    low = np.array(request.key.low_corner(SHAPE.cells), float) - SHAPE.apron
    return run_box(_noise_of(request.recipe), low, 1.0, (SHAPE.samples,) * 3)


@cache
def _noise_of(recipe: WorldRecipe) -> Tape:
    tape = flatten(recipe, 0).tape
    rows = np.isin(tape.code[:, ops.CODE], MOVES_OR_NOISE)
    columns = int(rows[: tape.columns].sum())
    starts = np.array([columns, rows.sum()], np.int32)
    return replace(tape, code=tape.code[rows], keys=tape.keys[rows], columns=columns, starts=starts)


def _field(request: ChunkRequest) -> object:
    return sample_near_surface(request.recipe, request.key, SHAPE)


STAGES: Final[dict[str, Callable[[Ready], object]]] = {
    "proof": lambda chunk: prove(chunk.request.recipe, chunk.request.key, SHAPE),
    "field": lambda chunk: _field(chunk.request),
    "mesh, normals": lambda chunk: extract(chunk.samples),
    "encode native": lambda chunk: encode(chunk.mesh, chunk.placement),
    "encode GLB": lambda chunk: encode(chunk.mesh, chunk.placement, GLB),
    "whole chunk, native": lambda chunk: build_chunk(chunk.request),
}


FLOORS: Final[dict[str, Callable[[Ready], object]]] = {
    "every sample": lambda chunk: sample(chunk.request.recipe, chunk.request.key, SHAPE),
    "noise alone": lambda chunk: noise_alone(chunk.request),
    "samples read": lambda chunk: chunk.samples.density.max(),
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per scene: milliseconds per chunk for each stage and for all of `build_chunk`."""
    for scene in SCENES.values():
        chunks = prepare(scene, scale.chunks)
        rounds = in_turns({name: timed(stage, chunks, MS) for name, stage in (STAGES | FLOORS).items()}, scale.rounds)
        count = Figure("triangles", "a chunk", (triangles(chunks),))
        yield Line(scene.name, (count, *figures(rounds, "ms")))
