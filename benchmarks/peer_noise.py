"""Other people's noise, as this project's benchmarks ask for it: one thread, the points of a chunk's samples."""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any, Final

import numba
import numpy as np
from numpy.typing import NDArray
from opensimplex import OpenSimplex  # type: ignore[import-untyped]

from benchmarks.scenes import SEED, SHAPE
from chunkserver.grid import ChunkKey

FAST_NOISE: Final = "pyfastnoiselite"
OPEN_SIMPLEX: Final = "opensimplex"
# Optional: it has no wheels for the newest Pythons. Without it our own figures stand alone.
_library: Final[Any] = (
    importlib.import_module(f"{FAST_NOISE}.{FAST_NOISE}") if importlib.util.find_spec(FAST_NOISE) else None
)

Points = NDArray[np.float32]
Generator = Callable[[Points], NDArray[np.float32]]


def has_fast_noise() -> bool:
    """Whether pyfastnoiselite is installed."""
    return _library is not None


def fast_noise(kind: str, frequency: float, octaves: int = 1, returns: str = "Distance") -> Generator:
    """Return pyfastnoiselite's generator: points (dimensions, n) float32, voxels, to values (n,) float32.

    kind, returns: as it calls them. octaves: more than one is its FBm.
    """
    noise = _library.FastNoiseLite(seed=SEED)
    noise.noise_type = _library.NoiseType[f"NoiseType_{kind}"]
    noise.frequency = frequency
    noise.fractal_type = _library.FractalType[f"FractalType_{'FBm' if octaves > 1 else 'None'}"]
    noise.fractal_octaves = octaves
    noise.cellular_distance_function = _library.CellularDistanceFunction.CellularDistanceFunction_Euclidean
    noise.cellular_return_type = _library.CellularReturnType[f"CellularReturnType_{returns}"]
    generate: Generator = noise.gen_from_coords
    return generate


def points(key: ChunkKey, dimensions: int) -> Points:
    """Return the coordinates of a chunk's samples, or of its columns of them: (dimensions, n), x first."""
    low = key.low_corner(SHAPE.cells)
    places = low if dimensions == 3 else (low[0], low[2])
    steps = [np.arange(SHAPE.samples, dtype=np.float32) + (place - SHAPE.apron) for place in places]
    return np.stack([axis.ravel() for axis in np.meshgrid(*steps)]).astype(np.float32)


def open_simplex(dimensions: int) -> Callable[[list[NDArray[np.float64]]], NDArray[np.float64]]:
    """Return opensimplex' generator, which Numba compiles: an array of coordinates per axis, x first, to a grid."""
    numba.set_num_threads(1)
    noise = OpenSimplex(SEED)
    return lambda axes: (noise.noise3array if dimensions == 3 else noise.noise2array)(*axes)


def axes(key: ChunkKey, dimensions: int, frequency: float) -> list[NDArray[np.float64]]:
    """Return the coordinates of a chunk's samples, or of its columns of them, in lattice cells: an array per axis."""
    low = key.low_corner(SHAPE.cells)
    places = low if dimensions == 3 else (low[0], low[2])
    steps = np.arange(SHAPE.samples, dtype=np.float64)
    return [(steps + (place - SHAPE.apron)) * frequency for place in places]
