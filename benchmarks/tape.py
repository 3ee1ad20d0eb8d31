"""Milliseconds per chunk: the field of a recipe beside one function of the same field, written by hand for Numba.

Both write the same bits. A recipe is data: nothing is compiled for it. The function was written for this one field,
knows its constants, works out once per axis what depends on one axis, and keeps between nodes nothing but registers.
Solids are 25 shapes and 25 nodes that join and move them. How many times ours it is stands behind its figure: less
than 1 is what it costs to be a tape. The function's noise is no faster than the tape's, or the comparison would be of
two noises: whoever makes one faster makes the other so too.
"""

from collections.abc import Callable, Iterator

from benchmarks import hand_solids, hand_terrain
from benchmarks.measure import MS, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import AROUND, SCENES, SEED, SHAPE, prepare
from chunkserver.field import sample
from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, builtin, canonical


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per field: milliseconds per chunk for its tape and for its function."""
    underground = [chunk.request.key for chunk in prepare(SCENES["terrain underground"], scale.chunks)]
    yield _line("terrain", WorldRecipe(SEED, builtin("terrain")), hand_terrain.terrain(SEED), underground, scale.rounds)
    solids = WorldRecipe(SEED, canonical(hand_solids.recipe()))
    yield _line("50 nodes of solids", solids, hand_solids.solids, list(AROUND[: scale.chunks]), scale.rounds)


def _line(
    name: str, recipe: WorldRecipe, by_hand: Callable[[ChunkKey], object], keys: list[ChunkKey], rounds: int
) -> Line:
    candidates = {
        "chunkserver": timed(lambda key: sample(recipe, key, SHAPE), keys, MS),
        "by hand": timed(by_hand, keys, MS),
    }
    return Line(name, beside_first(in_turns(candidates, rounds), "ms"))
