"""The field in plain Python, one point at a time: what the compiled interpreter must give, bit for bit.

Numbers are numpy scalars, so every step rounds where its type says. Nothing is compiled and nothing is shared with
`chunkserver.field` but the tables of constants, the keys of noises and the fade rule.
"""

import numpy as np

from chunkserver.field.levels import visible, weight
from chunkserver.field.tape import noise_name
from chunkserver.recipe import nodes
from tests.reference.noise_twin import gradient2, simplex3

f32 = np.float32


def octave(
    node: nodes.Simplex3 | nodes.Fbm, band: int, frequency: float, seed: int, point: list[np.float64]
) -> np.float32:
    """Return one octave of noise at a point: 3-D simplex, or 2-D gradient noise for `fbm2`."""
    offsets, keys = noise_name(seed, node.salt, band)
    x, y, z = (c * frequency + offset for c, offset in zip(point, offsets, strict=True))
    return gradient2(x, y, z, keys) if node.op == "fbm2" else simplex3(x, y, z, keys)


def evaluate(node: nodes.Node, seed: int, lod: int, point: list[np.float64]) -> np.float32:
    """Return the density at one point (x, y, z), voxels, before the field is clamped."""
    match node:
        case nodes.Constant():
            return f32(node.value)
        case nodes.Axis():
            return f32(point["xyz".index(node.op)])
        case nodes.Sphere():
            dx, dy, dz = (c - center for c, center in zip(point, node.center, strict=True))
            return f32(np.sqrt(dx * dx + dy * dy + dz * dz) - node.radius)
        case nodes.Simplex3():
            return octaves(node, [(node.frequency, 1.0)], 0, seed, lod, point)
        case nodes.Fbm():
            return octaves(node, node.bands(), 1, seed, lod, point)
        case nodes.Binary():
            return combine(node.op, evaluate(node.a, seed, lod, point), evaluate(node.b, seed, lod, point))
    raise AssertionError(f"the twin does not know {node}")


def octaves(
    node: nodes.Simplex3 | nodes.Fbm,
    bands: list[tuple[float, float]],
    first: int,
    seed: int,
    lod: int,
    point: list[np.float64],
) -> np.float32:
    """Sum octaves of (frequency, amplitude), numbered from `first`, each faded for the level."""
    total = sum(amplitude for _, amplitude in bands)
    value = f32(0)
    for band, (frequency, amplitude) in enumerate(bands, first):
        faded = amplitude / total * weight(1 / frequency, lod)
        if faded != 0:
            value = value + f32(faded) * octave(node, band, frequency, seed, point)
    return value


def combine(op: str, a: np.float32, b: np.float32) -> np.float32:
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


def density(node: nodes.Node, seed: int, lod: int, point: list[np.float64]) -> np.float32:
    """Return the density at one point as `sample` gives it: clamped, and air where it is not a number."""
    limit = f32(max(65536, 4 * 2**lod))
    value = evaluate(visible(node, lod), seed, lod, point)
    if np.isnan(value):
        return limit
    return min(max(value, -limit), limit)
