"""The field in plain Python, one point at a time: what the compiled interpreter must give, bit for bit.

Numbers are numpy scalars, so every step rounds where its type says. Nothing is compiled and nothing is shared with
`chunkserver.field` but constants, the facts and the names of noises, and the fade rule. It leaves nothing out: a coarse
level's density has its sign, and its value wherever the level leaves no operand of `min` or `max` out.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from chunkserver.field.flatten import RANDOM_OCTAVE
from chunkserver.field.levels import weight
from chunkserver.field.noise.facts import NOISES
from chunkserver.field.noise.lattice import ROUND_2
from chunkserver.field.noise.names import noise_name
from chunkserver.recipe import nodes
from tests.reference import noise_twin
from tests.reference.shapes_twin import distance

f32 = np.float32
f64 = np.float64

SIGNS = {"ridged": 1.0, "billow": -1.0}


class World(NamedTuple):
    """What a recipe is evaluated in."""

    seed: int
    lod: int


class Here(NamedTuple):
    """Where a subtree is evaluated: its point, the repeated cell around it, voxels in each of its units."""

    point: tuple[np.float64, ...]
    cell: tuple[np.float64, ...] = (f64(0), f64(0), f64(0))
    scale: float = 1.0

    def moved(self, point: Sequence[np.float64]) -> "Here":
        return self._replace(point=tuple(point))


def evaluate(node: Any, world: World, here: Here) -> np.float32:
    """Return the value at one point, before the field is clamped."""
    match node:
        case nodes.Constant():
            return f32(node.value)
        case nodes.Axis():
            return f32(here.point["xyz".index(node.op)])
        case nodes.Random():
            return random(node, world, here)
        case nodes.Plane() | nodes.Shape():
            return distance(node, here.point, lambda depth: 1 - weight(2 * depth * here.scale, world.lod))
        case nodes.Noise() | nodes.Cellular():
            return one_octave(node, world, here)
        case nodes.Sum():
            return octaves(node, world, here)
    return placed(node, world, here) if type(node) in PLACES else combined(node, world, here)


def combined(node: Any, world: World, here: Here) -> np.float32:
    """Return the value of a node that does not move its operands' points."""
    value = {name: evaluate(child, world, here) for name, child in node.children()}
    match node:
        case nodes.Binary(op=op):
            return two(op, value["a"], value["b"])
        case nodes.Abs():
            return abs(value["a"])
        case nodes.Clamp():
            return two("min", two("max", value["a"], f32(node.low)), f32(node.high))
        case nodes.Smooth(op="smooth_min"):
            return smooth_min(value["a"], value["b"], node.radius)
        case nodes.Smooth():
            return -smooth_min(-value["a"], -value["b"], node.radius)
        case nodes.Select():
            return select(node, value["by"], value["below"], value["above"])
        case nodes.Remap():
            return remap(node, value["a"])
        case nodes.Heightfield():
            return f32(here.point[1] - f64(value["height"]))
    raise AssertionError(f"the twin does not know {node}")


def two(op: str, a: np.float32, b: np.float32) -> np.float32:
    match op:
        case "add":
            return a + b
        case "subtract":
            return a - b
        case "multiply":
            return a * b
        case "min":
            return a if a < b else b
        case _:
            return a if a > b else b


def smooth_min(a: np.float32, b: np.float32, radius: float) -> np.float32:
    near = max(f32(radius) - abs(a - b), f32(0))
    return min(a, b) - near * near * f32(0.25 / radius)


def select(node: nodes.Select, by: np.float32, below: np.float32, above: np.float32) -> np.float32:
    first, last = f32(node.at - node.width / 2), f32(node.at + node.width / 2)
    if by >= last:
        return above
    if by <= first:
        return below
    t = (by - first) * f32(1 / node.width)
    return below + (t * t) * (f32(3) - (t + t)) * (above - below)


def remap(node: nodes.Remap, a: np.float32) -> np.float32:
    value = f32(node.points[0][1])
    for (start, low), (stop, high) in itertools.pairwise(node.points):
        along = (a - f32(start)) * f32(1 / (stop - start))
        value = value + f32(high - low) * min(max(along, f32(0)), f32(1))
    return value


def placed(node: Any, world: World, here: Here) -> np.float32:
    """Return the value of a node that looks its operand up at another point."""
    inner = evaluate(node.a, world, inside(node, world, here))
    match node:
        case nodes.Scale():
            return inner * f32(min(node.factor))
        case nodes.Repeat():
            faded = weight(min(filter(None, node.period)) * here.scale, world.lod)
            return inner if faded == 1 else inner * f32(faded) + f32(node.mean * (1 - faded))
    return inner


def inside(node: Any, world: World, here: Here) -> Here:
    """Return where the operand `a` of a node is looked up."""
    point = here.point
    match node:
        case nodes.Translate():
            return here.moved([c - f64(offset) for c, offset in zip(point, node.offset, strict=True)])
        case nodes.Scale():
            shrunk = [c * f64(1 / factor) for c, factor in zip(point, node.factor, strict=True)]
            return here.moved(shrunk)._replace(scale=here.scale * min(node.factor))
        case nodes.Rotate():
            return here.moved([x * point[0] + y * point[1] + z * point[2] for x, y, z in turned_back(node.quaternion)])
        case nodes.Repeat():
            cell = [cell_of(c, period) if period else f64(0) for c, period in zip(point, node.period, strict=True)]
            kept = [c - period * n for c, n, period in zip(point, cell, node.period, strict=True)]
            return here.moved(kept)._replace(cell=tuple(cell))
        case nodes.Warp():
            by = [evaluate(getattr(node, name), world, here) for name in "xyz"]
            return here.moved([c + f64(step) for c, step in zip(point, by, strict=True)])
    return here._replace(scale=here.scale * node.factor)


def cell_of(c: np.float64, period: float) -> np.float64:
    number = np.rint(c * f64(1 / period))
    return f64(number + 1 if c - period * number >= period / 2 else number)


PLACES = {nodes.Translate, nodes.Scale, nodes.Rotate, nodes.Repeat, nodes.Warp, nodes.Detailed}


def turned_back(quaternion: Sequence[float]) -> list[tuple[float, float, float]]:
    length = math.sqrt(math.fsum(part * part for part in quaternion))
    x, y, z, w = (part / length for part in quaternion)
    return [
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    ]


def random(node: nodes.Random, world: World, here: Here) -> np.float32:
    _, keys = noise_name(world.seed, node.salt, RANDOM_OCTAVE)
    corner = {axis: int(at) + noise_twin.EXPONENT for axis, at in enumerate(here.cell)}
    return noise_twin.unit(noise_twin.stir(noise_twin.corner_hash(corner, keys), ROUND_2))


def one_octave(node: nodes.Noise | nodes.Cellular, world: World, here: Here) -> np.float32:
    faded = weight(1 / node.frequency * here.scale, world.lod)
    if isinstance(node, nodes.Noise):
        return f32(faded) * noise(node.op, node.frequency, node.salt, 0, world, here) if faded else f32(0)
    mean = f32(NOISES[f"{node.op} {node.returns}"].mean_at(node.jitter) * (1 - faded))
    extras = node.jitter, ["distance", "edge", "value"].index(node.returns)
    return mean + f32(faded) * noise(node.op, node.frequency, node.salt, 0, world, here, *extras) if faded else mean


def octaves(node: nodes.Sum, world: World, here: Here) -> np.float32:
    """Return the sum of the octaves, numbered from 1, each faded for the level."""
    bands = node.bands()
    total = math.fsum(amplitude for _, amplitude in bands)
    mean = 1 - 2 * NOISES[node.of_octave].mean_absolute
    value = f32(0)
    for number, (frequency, amplitude) in enumerate(bands, 1):
        faded = weight(1 / frequency * here.scale, world.lod)
        share = SIGNS.get(node.op[:-1], 0.0) * amplitude / total
        raw = noise(node.of_octave, frequency, node.salt, number, world, here) if faded else f32(0)
        if share:
            lifted = f32(share * (mean * (1 - faded) + faded))
            value = value + (lifted + f32(-2 * share * faded) * abs(raw))
        elif faded:
            value = value + f32(amplitude / total * faded) * raw
    return value


def noise(op: str, frequency: float, salt: int, number: int, world: World, here: Here, *extras: float) -> np.float32:
    """Return one octave of a noise at a point."""
    offsets, keys = noise_name(world.seed, salt, number)
    x, y, z = (c * frequency + offset for c, offset in zip(here.point, offsets, strict=True))
    of: Callable[..., np.float32] = getattr(noise_twin, op)
    return of(x, y, z, keys, *extras)


def density(root: nodes.Node, seed: int, lod: int, point: Sequence[np.float64]) -> np.float32:
    """Return the density at one point as `sample` gives it, clamped."""
    limit = f32(max(65536, 4 * 2**lod))
    value = evaluate(root, World(seed, lod), Here(tuple(point)))
    return min(max(value, -limit), limit)
