"""Strokes for tests, as a user writes them, and worlds with edits: their samples, and what fields say to a fold."""

import base64
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits import Bricks, Deltas
from chunkserver.edits.arena import Arena
from chunkserver.edits.boxes import Box
from chunkserver.field import sample
from chunkserver.field.flatten import flatten
from chunkserver.field.intervals import ALL_FINITE, bounds
from chunkserver.field.points import run_box
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples
from tests.worlds import Densities

Stroke = dict[str, Any]

SLOTS = 1 << 12
SHAPES = ("sphere", "box", "capsule")
OPS = ("carve", "fill", "add", "smooth", "flatten")


def small_arena(slots: int = SLOTS) -> Arena:
    """Return an arena of a test's size."""
    return Arena(np.zeros((slots, 4096), np.int32))


def no_bricks(lods: int = 21, slots: int = SLOTS) -> Bricks:
    """Return a world without edits."""
    return Bricks(lods, small_arena(slots))


def place(point: Iterable[float]) -> tuple[int, int, int]:
    """Return a lattice point from any three numbers that are whole."""
    x, y, z = (int(at) for at in point)
    return x, y, z


def shape_of(rng: np.random.Generator, shape: str, middle: tuple[float, ...], size: float) -> Stroke:
    """Return the fields of a shape near a point; `size` is its radius, or the largest half extent."""
    center = [float(at) for at in np.array(middle) + rng.uniform(-0.5, 0.5, 3)]
    if shape == "sphere":
        return {"shape": shape, "center": center, "radius": size}
    if shape == "capsule":
        end = [float(at) for at in np.array(center) + rng.uniform(-size, size, 3)]
        return {"shape": shape, "a": center, "b": end, "radius": size / 2}
    half = [float(side) for side in rng.uniform(0.4, 1.0, 3) * size]
    return {"shape": shape, "center": center, "half_extents": half, "rotation": [float(q) for q in rng.normal(size=4)]}


def op_of(rng: np.random.Generator, op: str, middle: tuple[float, ...]) -> Stroke:
    """Return the fields of an op near a point."""
    if op == "add":
        return {"op": op, "strength": float(rng.uniform(-3, 3))}
    if op == "smooth":
        return {"op": op, "strength": float(rng.uniform(0, 1))}
    if op == "flatten":
        normal = [float(part) for part in rng.normal(size=3)]
        return {"op": op, "point": list(map(float, middle)), "normal": normal, "strength": float(rng.uniform(0, 1))}
    return {"op": op}


def delta_of(rng: np.random.Generator, low: tuple[int, ...], size: tuple[int, int, int]) -> Stroke:
    """Return a delta of random integers."""
    x, y, z = size
    values = rng.integers(-(1 << 20), (1 << 20) + 1, (y, z, x)).astype("<i4")
    return {"op": "delta", "min": list(low), "size": list(size), "values": base64.b64encode(values.tobytes()).decode()}


def random_stroke(rng: np.random.Generator, middle: tuple[float, ...], size: float) -> Stroke:
    """Return any stroke near a point."""
    op = str(rng.choice((*OPS, "delta")))
    if op == "delta":
        return delta_of(rng, tuple(int(at) for at in middle), (5, 4, 3))
    return op_of(rng, op, middle) | shape_of(rng, str(rng.choice(SHAPES)), middle, size)


@cache
def field_of(recipe: WorldRecipe) -> Callable[[Box], Densities]:
    """Return what a world's field has over boxes of LOD 0 before any edit."""
    tape = flatten(recipe, 0).tape
    return lambda box: run_box(tape, np.array(box.low, float), 1.0, box.shape)


@cache
def bounds_of(recipe: WorldRecipe) -> Callable[[NDArray[np.float64], NDArray[np.float64]], Any]:
    """Return what bounds a world's field over boxes of LOD 0."""
    tape = flatten(recipe, 0).kept

    def bound(low: NDArray[np.float64], high: NDArray[np.float64]) -> Any:
        found = bounds(tape, low, high)
        known = found.failed == ALL_FINITE
        return (
            np.where(known, found.low[tape.result], -np.inf).astype(np.float64),
            np.where(known, found.high[tape.result], np.inf).astype(np.float64),
        )

    return bound


def edited(recipe: WorldRecipe, bricks: Bricks, key: ChunkKey, cells: int = 32, coarser: int = 0) -> Samples:
    """Return the samples of a chunk of a world with edits."""
    shape = ChunkShape(cells)
    samples = sample(recipe, key, shape, coarser)
    Deltas.of(bricks, key, shape, coarser).add_to(samples, bricks.arena.deltas)
    return samples


def dense(bricks: Bricks, lod: int, box: Box) -> NDArray[np.int32]:
    """Return the deltas of a box of a level, (y, z, x), brick by brick."""
    deltas = np.zeros(box.shape, np.int32)
    for (level, *place), brick in bricks:
        low = tuple(16 * at for at in place)
        points = Box((low[0], low[1], low[2]), (low[0] + 15, low[1] + 15, low[2] + 15))
        if level == lod and points.shared(box).points:
            deltas[points.part_of(box)] = brick.deltas[box.part_of(points)]
    return deltas
