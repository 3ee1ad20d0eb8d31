"""Every noise as one function of points, by its name in `NOISES`: compiled, as its plain twin, as its definition."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import ops
from chunkserver.field.noise import NOISES, lattice
from chunkserver.field.noise.blended import add_blended
from chunkserver.field.noise.cellular import DISTANCE, EDGE, VALUE, add_cellular2, add_cellular3
from chunkserver.field.noise.names import noise_name
from chunkserver.field.noise.simplex2 import add_simplex2
from chunkserver.field.noise.simplex3 import add_simplex3
from tests.reference import field_oracle, noise_twin

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

KERNELS: Final[dict[str, Any]] = {
    **{
        name: partial(add_blended, getattr(ops, name.upper()))
        for name in ("gradient2", "gradient3", "value2", "value3")
    },
    "simplex2": add_simplex2,
    "simplex3": add_simplex3,
    "cellular2": add_cellular2,
    "cellular3": add_cellular3,
}
RETURNED: Final = {"distance": DISTANCE, "edge": EDGE, "value": VALUE}

ALL: Final = tuple(NOISES)
SMOOTH: Final = tuple(name for name in ALL if not name.startswith("cellular"))
CONTINUOUS: Final = tuple(name for name in ALL if np.isfinite(NOISES[name].lipschitz))


def keys_of(seed: int) -> tuple[int, ...]:
    """Return the hash keys that a seed gives."""
    return noise_name(seed, 0, 0)[1]


KEYS: Final = keys_of(7)
BEYOND: Final = 64
"""Numbers behind those asked for, which no noise may write."""
CHUNK: Final = 1_000_000
"""Points at a time: 24 MB of coordinates."""


def evaluate(
    noise: str,
    points: Doubles,
    name: tuple[int, int, int] | None = None,
    *,
    keys: Sequence[int] = KEYS,
    frequency: float = 1.0,
    jitter: float = 1.0,
    amplitude: float = 1.0,
    below: Floats | None = None,
    width: int = 0,
) -> Floats:
    """Run a compiled noise at points (n, 3): that named (seed, salt, octave), or that of `keys` without offset."""
    offsets: Sequence[float] = (0.0, 0.0, 0.0)
    if name:
        offsets, keys = noise_name(*name)
    op, _, returned = noise.partition(" ")
    numbers = np.array([amplitude, frequency, *offsets, jitter, RETURNED.get(returned, 0)])
    below = np.zeros(len(points), np.float32) if below is None else below
    room = np.full(len(points) + BEYOND, np.nan, np.float32)
    out = room[: len(points)]
    x, y, z = np.ascontiguousarray(points.T)
    KERNELS[op](x, y, z, numbers, np.array(keys, np.uint32), below, out, *lattice.scratch(), width)
    assert np.isnan(room[len(points) :]).all()
    return out


def twin(noise: str, points: Doubles, jitter: float = 1.0) -> Floats:
    """Return what `evaluate` should, by the plain twin."""
    op, _, returned = noise.partition(" ")
    own = (jitter, RETURNED[returned]) if returned else ()
    function = getattr(noise_twin, op)
    return np.array([function(*point, KEYS, *own) for point in points], np.float32)


def defined(
    noise: str, points: Doubles, cells: NDArray[np.int64] | None = None, reach: int = 2
) -> tuple[Doubles, Doubles]:
    """Return what `evaluate` should at cells + points, in float64, and the distances (n,) to where it may differ.

    reach: how many cells away feature points are looked for. `evaluate` is right with 1, they say: so 2 here.
    """
    op, _, returned = noise.partition(" ")
    if not returned:
        return getattr(field_oracle, op)(points, KEYS, cells), np.ones(len(points))
    first, second, value = field_oracle.cellular(points, KEYS, cells, NOISES[noise].dimensions, jitter=1.0, reach=reach)
    if returned == "value":
        return value, np.where(first < 1, second - first, 0)
    near, far = np.minimum(first, 1), np.minimum(second, 1)
    return (near if returned == "distance" else far - near), np.ones(len(points))


def draws(rng: np.random.Generator, extent: float, total: int, chunk: int = CHUNK) -> Iterator[Doubles]:
    """Yield random points (n, 3) within `extent`, `total` of them, `chunk` at a time."""
    for start in range(0, total, chunk):
        yield rng.uniform(-extent, extent, (min(chunk, total - start), 3))


def climb(function: Any, points: Doubles, rng: np.random.Generator) -> float:
    """Return the largest value found from the best 100 points by ever smaller random steps."""
    for step in 0.2 * 0.75 ** np.arange(50):
        points = points[np.argsort(-function(points))[:100]]
        points = np.concatenate([points, np.repeat(points, 10, 0) + rng.normal(0, step, (1000, points.shape[1]))])
    return float(function(points).max())
