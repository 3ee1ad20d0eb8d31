"""Nanoseconds per sample of a 35^3 chunk; for 2-D noise, per column of samples (35^2).

Ours is a recipe of this noise alone, sampled as any chunk is: coordinates are made on the way, in float64.
pyfastnoiselite, where it is installed, gets ready float32 coordinates of every sample, and makes the noise whose name
stands in brackets. opensimplex, compiled by Numba, gets ready float64 coordinates per axis, scaled by the frequency,
and makes float64. All copy what depends on columns alone to all 35 planes.
"""

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import peer_noise
from benchmarks.measure import NS, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SEED, SHAPE, layers
from chunkserver.field import sample
from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, canonical

FREQUENCY: Final = 0.05


class Noise(NamedTuple):
    """One kind of noise, and the like of it elsewhere.

    dimensions: 3 for every sample of a chunk, 2 for its columns of samples.
    kind, returns: what pyfastnoiselite calls it.
    """

    name: str
    tree: dict[str, Any]
    dimensions: int
    kind: str
    returns: str = "Distance"


def _noise(op: str, dimensions: int, kind: str) -> Noise:
    tree = {"op": f"{op}{dimensions}", "frequency": FREQUENCY}
    return Noise(f"{op} {dimensions}-D ({kind})", tree, dimensions, kind)


def _cellular(dimensions: int, returns: str, theirs: str) -> Noise:
    tree = {"op": f"cellular{dimensions}", "frequency": FREQUENCY, "returns": returns}
    return Noise(f"cellular {dimensions}-D, {returns}", tree, dimensions, "Cellular", theirs)


NOISES: Final = (
    _noise("gradient", 2, "Perlin"),
    _noise("gradient", 3, "Perlin"),
    _noise("value", 2, "Value"),
    _noise("value", 3, "Value"),
    _noise("simplex", 2, "OpenSimplex2"),
    _noise("simplex", 3, "OpenSimplex2"),
    _cellular(2, "distance", "Distance"),
    _cellular(3, "distance", "Distance"),
    _cellular(3, "edge", "Distance2Sub"),
    _cellular(3, "value", "CellValue"),
    Noise("fbm 2-D, 5 octaves (Perlin)", {"op": "fbm2", "frequency": 0.02, "octaves": 5}, 2, "Perlin"),
)


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per kind of noise: nanoseconds per sample, or per column of samples, of a chunk."""
    for noise in NOISES:
        rounds = in_turns(_candidates(noise, list(layers((0, 1), 12)[: scale.chunks])), scale.rounds)
        yield Line(noise.name, beside_first(rounds, "ns"))


def _candidates(noise: Noise, keys: list[ChunkKey]) -> dict[str, Callable[[], float]]:
    recipe = WorldRecipe(SEED, canonical(noise.tree))
    dimensions, frequency = noise.dimensions, noise.tree["frequency"]
    per_second = NS / SHAPE.samples**dimensions
    candidates = {"chunkserver": timed(lambda key: sample(recipe, key, SHAPE), keys, per_second)}
    if peer_noise.has_fast_noise():
        generate = peer_noise.fast_noise(noise.kind, frequency, noise.tree.get("octaves", 1), noise.returns)
        points = [peer_noise.points(key, dimensions) for key in keys]
        candidates[peer_noise.FAST_NOISE] = timed(_to_planes(generate, dimensions), points, per_second)
    if noise.tree["op"].startswith("simplex"):
        grid = _to_planes(peer_noise.open_simplex(dimensions), dimensions)
        axes = [peer_noise.axes(key, dimensions, frequency) for key in keys]
        candidates[peer_noise.OPEN_SIMPLEX] = timed(grid, axes, per_second)
    return candidates


def _to_planes(generate: Callable[[Any], NDArray[Any]], dimensions: int) -> Callable[[Any], NDArray[Any]]:
    """Return an action that makes the values of all samples of a chunk, from those of its columns if need be."""
    if dimensions == 3:
        return generate
    planes = SHAPE.samples, SHAPE.samples**2
    return lambda points: np.broadcast_to(generate(points).ravel(), planes).copy()
