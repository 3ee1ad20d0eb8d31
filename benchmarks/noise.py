"""Nanoseconds per sample of a 35^3 chunk; for 2-D noise, per column of samples (35^2).

Ours is a recipe of this noise alone, sampled as any chunk is: coordinates are made on the way, in float64. The peer,
where it is installed, gets ready float32 coordinates, and makes the noise whose name stands in brackets. Both copy what
depends on columns alone to all 35 planes.
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
    peer_noise, peer_fractal, peer_returns: what the peer calls it.
    """

    name: str
    tree: dict[str, Any]
    dimensions: int
    peer_noise: str
    peer_fractal: str = "None"
    peer_returns: str = "Distance"


FREQUENCY: Final = 0.05


def _noise(op: str, dimensions: int, peer_noise: str) -> Noise:
    tree = {"op": f"{op}{dimensions}", "frequency": FREQUENCY}
    return Noise(f"{op} {dimensions}-D ({peer_noise})", tree, dimensions, peer_noise)


def _cellular(dimensions: int, returns: str, peer_returns: str) -> Noise:
    tree = {"op": f"cellular{dimensions}", "frequency": FREQUENCY, "returns": returns}
    return Noise(f"cellular {dimensions}-D, {returns}", tree, dimensions, "Cellular", peer_returns=peer_returns)


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
    Noise("fbm 2-D, 5 octaves (Perlin)", {"op": "fbm2", "frequency": 0.02, "octaves": OCTAVES}, 2, "Perlin", "FBm"),
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
        candidates[PEER] = timed(_generator(noise), points, per_second)
    return candidates


def _fast_noise(noise: Noise) -> Any:
    peer = _peer.FastNoiseLite(seed=SEED)
    peer.noise_type = _peer.NoiseType[f"NoiseType_{noise.peer_noise}"]
    peer.frequency = noise.tree["frequency"]
    peer.fractal_type = _peer.FractalType[f"FractalType_{noise.peer_fractal}"]
    peer.fractal_octaves = OCTAVES
    peer.cellular_distance_function = _peer.CellularDistanceFunction.CellularDistanceFunction_Euclidean
    peer.cellular_return_type = _peer.CellularReturnType[f"CellularReturnType_{noise.peer_returns}"]
    return peer


def _generator(noise: Noise) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """Return the peer's action for a chunk: points (dimensions, n) to the values of all its samples."""
    generate: Callable[[NDArray[np.float32]], NDArray[np.float32]] = _fast_noise(noise).gen_from_coords
    if noise.dimensions == 3:
        return generate
    planes = SHAPE.samples, SHAPE.samples**2
    return lambda points: np.broadcast_to(generate(points), planes).copy()


def _points(key: ChunkKey, dimensions: int) -> NDArray[np.float32]:
    """Return the coordinates of a chunk's samples as the peer wants them: (dimensions, n)."""
    low = key.low_corner(SHAPE.cells)
    axes = [np.arange(SHAPE.samples, dtype=np.float32) + (corner - SHAPE.apron) for corner in low[:dimensions]]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes)]).astype(np.float32)
