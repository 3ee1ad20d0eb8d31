"""Strokes in plain Python, one lattice point at a time: what the compiled ones must make, unit for unit.

Written from `docs/edits/strokes.md`, and takes strokes as a user writes them.
"""

import base64
import math
import struct
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Point = tuple[int, ...]
Value = Callable[[Point], float]
Deltas = Callable[[Point], int]
Stroke = dict[str, Any]


def rounded(x: float) -> int:
    return math.floor(x + 0.5)


def density(field: Value, deltas: Deltas, p: Point) -> float:
    return float(np.float32(field(p) + deltas(p) * 2.0**-10))


def box(stroke: Stroke) -> tuple[Point, Point]:
    """Return the first and the last point that a stroke may change."""
    if stroke["op"] == "delta":
        low, size = stroke["min"], stroke["size"]
        return tuple(low), tuple(a + n - 1 for a, n in zip(low, size, strict=True))
    match stroke["shape"]:
        case "sphere":
            ends, reach = [stroke["center"]], [stroke["radius"]] * 3
        case "capsule":
            ends, reach = [stroke["a"], stroke["b"]], [stroke["radius"]] * 3
        case "box":
            h = stroke["half_extents"]
            columns = list(zip(*axes(stroke), strict=True))
            ends = [stroke["center"]]
            reach = [abs(c[0]) * h[0] + abs(c[1]) * h[1] + abs(c[2]) * h[2] for c in columns]
    margin = max(4.0, depth(stroke)) if stroke["op"] in ("carve", "fill") else 0.0
    low = tuple(math.ceil(min(end[i] for end in ends) - reach[i] - margin) for i in range(3))
    high = tuple(math.floor(max(end[i] for end in ends) + reach[i] + margin) for i in range(3))
    return low, high


def points(stroke: Stroke) -> Iterator[Point]:
    low, high = box(stroke)
    return product(*(range(a, b + 1) for a, b in zip(low, high, strict=True)))


def depth(stroke: Stroke) -> float:
    return float(min(stroke["half_extents"]) if stroke["shape"] == "box" else stroke["radius"])


def unit(vector: list[float]) -> list[float]:
    length = math.sqrt(math.fsum(c * c for c in vector))
    return [c / length for c in vector]


def axes(stroke: Stroke) -> list[list[float]]:
    """Return the axes of a box, in the world."""
    x, y, z, w = unit(stroke.get("rotation", [0.0, 0.0, 0.0, 1.0]))
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
        [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
        [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
    ]


def length(x: float, y: float, z: float) -> float:
    return math.sqrt(x * x + y * y + z * z)


def distance(stroke: Stroke, p: Point) -> float:
    match stroke["shape"]:
        case "sphere":
            return length(*(a - b for a, b in zip(p, stroke["center"], strict=True))) - float(stroke["radius"])
        case "box":
            x, y, z = (a - b for a, b in zip(p, stroke["center"], strict=True))
            q = [
                abs(x * u + y * v + z * w) - half
                for (u, v, w), half in zip(axes(stroke), stroke["half_extents"], strict=True)
            ]
            return length(*(max(c, 0.0) for c in q)) + float(min(max(q), 0.0))
        case "capsule":
            x, y, z = (a - b for a, b in zip(p, stroke["a"], strict=True))
            u, v, w = (b - a for a, b in zip(stroke["a"], stroke["b"], strict=True))
            square = math.fsum((u * u, v * v, w * w))
            t = (x * u + y * v + z * w) * (1 / square if square else 0.0)
            t = min(max(t, 0.0), 1.0)
            return length(x - t * u, y - t * v, z - t * w) - float(stroke["radius"])
    raise ValueError(stroke)


def weight(stroke: Stroke, p: Point) -> float:
    u = min(max(-distance(stroke, p) / depth(stroke), 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


def mean(value: Value, p: Point) -> float:
    """Return the 1 2 1 mean along x, then z, then y."""

    def along(axis: int, inner: Value) -> Value:
        def at(q: Point) -> float:
            before, after = (tuple(c + step * (i == axis) for i, c in enumerate(q)) for step in (-1, 1))
            return (inner(before) + 2.0 * inner(q) + inner(after)) * 0.25

        return at

    return along(1, along(2, along(0, value)))(p)


def plane(stroke: Stroke, p: Point) -> float:
    x, y, z = ((a - b) * n for a, b, n in zip(p, stroke["point"], unit(stroke["normal"]), strict=True))
    return float(min(max(x + y + z, -65536.0), 65536.0))


def folded(stroke: Stroke, field: Value, deltas: Deltas, p: Point) -> int:
    """Return the delta of a point in the stroke's box after the stroke."""
    before = deltas(p)
    match stroke["op"]:
        case "carve":
            return max(before, rounded((-distance(stroke, p) - field(p)) * 1024))
        case "fill":
            return min(before, rounded((distance(stroke, p) - field(p)) * 1024))
        case "add":
            return before - rounded(stroke["strength"] * 1024 * weight(stroke, p))
        case "delta":
            low, (nx, _, nz) = stroke["min"], stroke["size"]
            x, y, z = (a - b for a, b in zip(p, low, strict=True))
            values = base64.b64decode(stroke["values"])
            (value,) = struct.unpack_from("<i", values, 4 * ((y * nz + z) * nx + x))
            return before + int(value)
    now = density(field, deltas, p)
    target = plane(stroke, p) if stroke["op"] == "flatten" else mean(lambda q: density(field, deltas, q), p)
    return before + rounded(stroke["strength"] * weight(stroke, p) * (target - now) * 1024)


def filtered(fine: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the deltas of a box of the next level, all at once; `fine` has a point more on each side."""
    sums = fine.astype(np.int64)
    for axis in range(3):
        along = np.moveaxis(sums, axis, 0)
        sums = np.moveaxis(along[:-2:2] + 2 * along[1:-1:2] + along[2::2], 0, axis)
    return (sums + 32 >> 6).astype(np.int32)


def halved(deltas: Deltas, p: Point) -> int:
    """Return the delta of a point of the next level."""
    total = 0
    for step in product((-1, 0, 1), repeat=3):
        total += math.prod(2 - abs(s) for s in step) * deltas(tuple(2 * c + s for c, s in zip(p, step, strict=True)))
    return (total + 32) >> 6
