"""Milliseconds per chunk of `terrain` surface at LOD 0, in one thread: with edits, and without.

- A whole chunk, from its key to its native bytes: pristine; with a ball of radius 6 carved out of it; and where all
  bricks that it reads are there. An edited chunk takes every sample, for any of them may have a delta.
- Its deltas, beside working out every sample: finding its bricks, which the server does, and adding their deltas to the
  samples, which a worker does. These are in the cache, as in a build; the bricks are in memory.
"""

import random
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from benchmarks.measure import MS, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SCENES, SEED, SHAPE, Ready, prepare
from chunkserver.edits import Arena, Bricks, Deltas, Edit
from chunkserver.field import Ground, sample
from chunkserver.pipeline import Edited, build_chunk
from chunkserver.recipe import WorldRecipe, builtin

SCENE: Final = "terrain surface"
EVERY: Final = "every sample"
CARVED: Final = "with a carve"
FULL: Final = "with all bricks"
RADIUS: Final = 6.0
ROOM: Final = SHAPE.cells * 2.0
"""Radius of a ball around a chunk's middle that changes every sample."""


class Dug(NamedTuple):
    """A chunk and its edits. What it costs to find its bricks is not in what `build` takes."""

    chunk: Ready
    bricks: Bricks
    deltas: Deltas

    def find(self) -> Deltas:
        """Find its bricks."""
        return Deltas.of(self.bricks, self.chunk.request.key, SHAPE)

    def build(self) -> object:
        """Build the edited chunk."""
        return build_chunk(self.chunk.request, edited=Edited(self.bricks.arena.deltas, self.deltas))


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for whole chunks and one for their deltas."""
    chunks, arena = prepare(SCENES[SCENE], scale.chunks), Arena()
    whole = {"pristine": timed(lambda chunk: build_chunk(chunk.request), chunks, MS)}
    deltas = {EVERY: timed(lambda chunk: sample(chunk.request.recipe, chunk.request.key, SHAPE), chunks, MS)}
    for kind, stroke in ((CARVED, _carve), (FULL, _ball)):
        dug = _dug(chunks, stroke, arena)
        whole[kind] = timed(Dug.build, dug, MS)
        deltas[f"bricks found, {kind}"] = timed(Dug.find, dug, MS)
        deltas[f"deltas added, {kind}"] = timed(_adding(chunks[0], arena), dug, MS)
    yield Line("whole chunk", beside_first(in_turns(whole, scale.rounds), "ms"))
    yield Line("its deltas", beside_first(in_turns(deltas, scale.rounds), "ms"))


def _adding(chunk: Ready, arena: Arena) -> Callable[[Dug], None]:
    """Return what adds the deltas of a chunk, always to the same samples."""
    samples = sample(chunk.request.recipe, chunk.request.key, SHAPE)
    return lambda dug: dug.deltas.add_to(samples, arena.deltas)


def _dug(chunks: list[Ready], stroke: Callable[[Ready], dict[str, object]], arena: Arena) -> list[Dug]:
    """Return the chunks, each with the bricks of one stroke."""
    ground = Ground(WorldRecipe(SEED, builtin(SCENES[SCENE].recipe)))
    dug = []
    for chunk in chunks:
        edit = Edit.of([stroke(chunk)])
        bricks = Bricks(1, arena).apply([edit], 1, lambda box: ground.sample(box.low, box.shape))
        dug.append(Dug(chunk, bricks, Deltas.of(bricks, chunk.request.key, SHAPE)))
    return dug


def _carve(chunk: Ready) -> dict[str, object]:
    """Return a ball around a vertex of the chunk's surface, so that it is dug out of the ground."""
    vertex = random.Random(SEED).choice(chunk.mesh.positions)
    places = chunk.placement.key.low_corner(SHAPE.cells)
    center = [low + (int(at) - 16384) / SHAPE.units_per_cell for low, at in zip(places, vertex, strict=False)]
    return {"op": "carve", "shape": "sphere", "center": center, "radius": RADIUS}


def _ball(chunk: Ready) -> dict[str, object]:
    """Return a ball that has a delta at every sample of the chunk."""
    center = [low + SHAPE.cells / 2 for low in chunk.request.key.low_corner(SHAPE.cells)]
    return {"op": "add", "shape": "sphere", "center": center, "radius": ROOM, "strength": 0.01}
