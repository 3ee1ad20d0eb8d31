"""Nanoseconds per sample of a 35^3 chunk; for 2-D noise, per column of samples (35^2).

Ours is a recipe of this noise alone, sampled as any chunk is: coordinates are made on the way, in float64, and the
columns' values are copied to all 35 planes. The peer, where it is installed, gets ready float32 coordinates.
"""

import importlib
import importlib.util
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import NS, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SEED, SHAPE, layers
from chunkserver.field import sample
from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, canonical

PEER: Final = "pyfastnoiselite"
# Optional: it has no wheels for the newest Pythons. Without it our own figures stand alone.
_peer: Final[Any] = importlib.import_module(f"{PEER}.{PEER}") if importlib.util.find_spec(PEER) else None

OCTAVES: Final = 5


class Noise(NamedTuple):
    """One kind of noise, and the like of it in the peer.

    dimensions: 3 for every sample of a chunk, 2 for its columns of samples.
    """

    name: str
    tree: dict[str, Any]
    dimensions: int
    peer_noise: str
    peer_fractal: str


NOISES: Final = (
    Noise("simplex 3-D", {"op": "simplex3", "frequency": 0.05}, 3, "OpenSimplex2", "None"),
    Noise("fbm 2-D, 5 octaves", {"op": "fbm2", "frequency": 0.02, "octaves": OCTAVES}, 2, "Perlin", "FBm"),
)


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per kind of noise: nanoseconds per sample, or per column of samples, of a chunk."""
    for noise in NOISES:
        rounds = in_turns(_candidates(noise, list(layers((0, 1), 12)[: scale.chunks])), scale.rounds)
        yield Line(noise.name, beside_first(rounds, "ns"))


def _candidates(noise: Noise, keys: list[ChunkKey]) -> dict[str, Callable[[], float]]:
    recipe = WorldRecipe(SEED, canonical(noise.tree))
    per_second = NS / SHAPE.samples**noise.dimensions
    candidates = {"chunkserver": timed(lambda key: sample(recipe, key, SHAPE), keys, per_second)}
    if _peer:
        points = [_points(key, noise.dimensions) for key in keys]
        name = f"{PEER} {noise.peer_noise}"
        candidates[name] = timed(_fast_noise(noise).gen_from_coords, points, per_second)
    return candidates


def _fast_noise(noise: Noise) -> Any:
    peer = _peer.FastNoiseLite(seed=SEED)
    peer.noise_type = _peer.NoiseType[f"NoiseType_{noise.peer_noise}"]
    peer.frequency = noise.tree["frequency"]
    peer.fractal_type = _peer.FractalType[f"FractalType_{noise.peer_fractal}"]
    peer.fractal_octaves = OCTAVES
    return peer


def _points(key: ChunkKey, dimensions: int) -> NDArray[np.float32]:
    """Return the coordinates of a chunk's samples as the peer wants them: (dimensions, n)."""
    low = key.low_corner(SHAPE.cells)
    axes = [np.arange(SHAPE.samples, dtype=np.float32) + (corner - SHAPE.apron) for corner in low[:dimensions]]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes)]).astype(np.float32)
