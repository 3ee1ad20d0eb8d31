"""Distances in plain Python, one point at a time: what the compiled ones must give, bit for bit."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from chunkserver.recipe import nodes

f32 = np.float32
f64 = np.float64


def distance(node: Any, point: Sequence[np.float64], lost: Callable[[float], float]) -> np.float32:
    """Return the distance to a shape. `lost`: the share of its depth that a shape of that depth has shrunk by."""
    if isinstance(node, nodes.Plane):
        length = math.sqrt(math.fsum(part * part for part in node.normal))
        x, y, z = (c * (part / length) for c, part in zip(point, node.normal, strict=True))
        return f32(x + y + z - node.offset)
    exact: f64 = OF[type(node)](node, point)
    return f32(exact + node.depth() * lost(node.depth()))


def minus(point: Sequence[np.float64], other: Sequence[float]) -> list[np.float64]:
    return [c - f64(o) for c, o in zip(point, other, strict=True)]


def length(parts: Sequence[np.float64]) -> np.float64:
    total = f64(0)
    for part in parts:
        total = total + part * part
    return f64(np.sqrt(total))


def corner(parts: Sequence[np.float64]) -> np.float64:
    """Return the distance to the corner where all parts are negative."""
    return length([max(part, f64(0)) for part in parts]) + min(max(parts), f64(0))


def sphere(node: nodes.Sphere, point: Sequence[np.float64]) -> np.float64:
    return length(minus(point, node.center)) - node.radius


def box(node: nodes.Box, point: Sequence[np.float64]) -> np.float64:
    inner = [extent - node.rounding for extent in node.half_extents]
    return corner([abs(c) - e for c, e in zip(minus(point, node.center), inner, strict=True)]) - node.rounding


def capsule(node: nodes.Capsule, point: Sequence[np.float64]) -> np.float64:
    away, along = minus(point, node.a), [b - a for a, b in zip(node.a, node.b, strict=True)]
    square = math.fsum(part * part for part in along)
    dot = away[0] * along[0] + away[1] * along[1] + away[2] * along[2]
    t = min(max(dot * f64(1 / square if square else 0), f64(0)), f64(1))
    return length([c - t * part for c, part in zip(away, along, strict=True)]) - node.radius


def torus(node: nodes.Torus, point: Sequence[np.float64]) -> np.float64:
    x, y, z = minus(point, node.center)
    return length([length([x, z]) - node.radius, y]) - node.tube


def cylinder(node: nodes.Cylinder, point: Sequence[np.float64]) -> np.float64:
    x, y, z = minus(point, node.center)
    return corner([length([x, z]) - node.radius, abs(y) - node.half_height])


OF: dict[type, Callable[[Any, Sequence[np.float64]], np.float64]] = {
    nodes.Sphere: sphere,
    nodes.Box: box,
    nodes.Capsule: capsule,
    nodes.Torus: torus,
    nodes.Cylinder: cylinder,
}
