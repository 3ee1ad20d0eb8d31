"""Noise from its definition, in numpy and float64: a sum over all lattice corners near enough, in no clever order."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.noise import lattice

Doubles = NDArray[np.float64]
Words = NDArray[np.uint32]
Integers = NDArray[np.int64]

EXPONENT = 0x4338 << 48
"""The bits of 1.5 * 2**52, which stay in each integer that is split off a coordinate: once a split."""


def stir(bits: Words, multiplier: np.uint32) -> Words:
    folded: Words = (bits ^ (bits >> np.uint32(16))) * multiplier
    return folded


def corner_bits(
    corner: Sequence[Integers],
    axes: Sequence[np.uint32],
    keys: Sequence[int],
    splits: int,
    multiplier: np.uint32 = lattice.ROUND_2,
) -> Words:
    """Return the hashes of lattice corners, given as integer arrays, one an axis, that broadcast against each other."""
    total = np.zeros((), np.uint32)
    for i, axis, key in zip(corner, axes, keys, strict=True):
        word = i.view(np.uint64) + np.uint64(splits * EXPONENT % 2**64)
        low, high = word.astype(np.uint32), (word >> np.uint64(32)).astype(np.uint32)
        total = total + stir(low * axis + high * lattice.PAGE + np.uint32(key), lattice.ROUND_1)
    return stir(total, multiplier)


def third(bits: Words) -> Integers:
    """Return which of three equal parts of the signed numbers the bits, but the top two, fall into."""
    signed = (bits << np.uint32(2)).view(np.int32).astype(np.int64)
    return np.where(signed < -(2**32 // 6), 0, np.where(signed > 2**32 // 6, 2, 1))


def gradient_3(bits: Words) -> Doubles:
    """Return the gradient, (n, 3), that 32-bit hashes pick: without x, without y, without z ... by thirds."""
    u, v = np.where(bits >> np.uint32(31), -1.0, 1.0), np.where(bits >> np.uint32(30) & np.uint32(1), -1.0, 1.0)
    zero = np.zeros_like(u)
    part = third(bits)[:, None]
    without_x = np.stack([zero, u, v], 1)
    without_y = np.stack([u, zero, v], 1)
    without_z = np.stack([u, v, zero], 1)
    return np.where(part == 0, without_x, np.where(part == 1, without_y, without_z))


def gradient_2(bits: Words) -> Doubles:
    """Return the gradient, (n, 2), that 32-bit hashes pick, by its angle."""
    angle = np.where(bits >> np.uint32(29) & np.uint32(1), 3, 1) * math.pi / 16
    swap = (bits >> np.uint32(28) & np.uint32(1)).astype(bool)
    long = np.where(bits >> np.uint32(31), -np.cos(angle), np.cos(angle))
    short = np.where(bits >> np.uint32(30) & np.uint32(1), -np.sin(angle), np.sin(angle))
    return np.stack([np.where(swap, short, long), np.where(swap, long, short)], 1)


def icosahedron(bits: Words) -> Doubles:
    """Return the gradient, (n, 3), that 32-bit hashes pick: a corner of an icosahedron, on a rectangle by thirds."""
    golden = (1 + math.sqrt(5)) / 2
    u = np.where(bits >> np.uint32(31), -1.0, 1.0)
    v = np.where(bits >> np.uint32(30) & np.uint32(1), -golden, golden)
    zero = np.zeros_like(u)
    rectangles = np.stack([np.stack(r, 1) for r in ((zero, u, v), (u, v, zero), (v, zero, u))])
    chosen: Doubles = rectangles[third(bits), np.arange(len(bits))]
    return chosen


def values(bits: Words) -> Doubles:
    """Return the random number, (n,), in [-1, 1], that 32-bit hashes stand for."""
    return bits.view(np.int32) / 2.0**31


def hashes(corner: Integers, keys: Sequence[int], splits: int, multiplier: np.uint32 = lattice.ROUND_2) -> Words:
    """Return the hashes of lattice points, (n, 3), or (n, 2) of x and z."""
    axes = (0, 2) if corner.shape[1] == 2 else (0, 1, 2)
    multipliers = [(lattice.AXIS_X, lattice.AXIS_Y, lattice.AXIS_Z)[axis] for axis in axes]
    return corner_bits(list(corner.T.copy()), multipliers, [keys[axis] for axis in axes], splits, multiplier)


def placed(points: Doubles, cells: Integers | None, dimensions: int) -> tuple[Doubles, Integers]:
    """Return points and the whole cells that they are counted from, of x and z alone where there are 2 dimensions."""
    axes = [0, 2] if dimensions == 2 else [0, 1, 2]
    whole = np.zeros((1, 3), np.int64) if cells is None else cells
    return points[:, axes], whole[:, axes]


def triangles(points: Doubles, whole: Integers) -> Iterator[tuple[Integers, Doubles]]:
    """Yield corners of triangles near enough to the points, skewed, and the ways from them.

    Skewed by p + sum(p) * 4 / 11. Points are skewed in float64, so they should be small. Cells are skewed as integers:
    as many steps along the diagonal as keep them whole, the rest goes back to the points.
    """
    rest = whole.sum(1, keepdims=True) % 11 * np.eye(1, 2, dtype=np.int64)
    points, whole = points + rest, whole - rest
    whole = whole + whole.sum(1, keepdims=True) // 11 * 4
    skewed = points + points.sum(1, keepdims=True) * 4 / 11
    for step in itertools.product(range(-1, 3), repeat=2):
        corner = np.floor(skewed).astype(np.int64) + step
        yield whole + corner, points - (corner - corner.sum(1, keepdims=True) * 4 / 19)


def simplex2(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return simplex noise at points (n, 3), in lattice cells, from `cells` (n, 3) on."""
    value = np.zeros(len(points))
    for corner, away in triangles(*placed(points, cells, 2)):
        slope = (gradient_2(hashes(corner, keys, splits=5)) * away).sum(1)
        value += np.maximum(0.5 - (away**2).sum(1), 0) ** 4 * slope
    return value * 99.5


def simplex3(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return simplex noise at points (n, 3), in lattice cells, from `cells` (n, 3) on.

    Its lattice is that of whole numbers and, half a cell away along each axis, a second one.
    """
    points, whole = placed(points, cells, 3)
    value = np.zeros(len(points))
    for half, multiplier in ((0.0, lattice.ROUND_2), (0.5, lattice.ROUND_1)):
        for step in itertools.product((-1, 0, 1, 2), repeat=3):
            corner = np.floor(points - half).astype(np.int64) + step
            away = points - half - corner
            slope = (gradient_3(hashes(whole + corner, keys, splits=1, multiplier=multiplier)) * away).sum(1)
            value += np.maximum(0.5 - (away**2).sum(1), 0) ** 4 * slope
    return value * 76.8


def blend(
    points: Doubles, whole: Integers, keys: Sequence[int], corner_value: Callable[[Words, Doubles], Doubles]
) -> Doubles:
    """Return the sum over the corners, half-way between cells, of corner_value(hashes, ways) times its weight."""
    value = np.zeros(len(points))
    for step in itertools.product((0, 1), repeat=points.shape[1]):
        corner = np.rint(points) + step
        away = points - (corner - 0.5)
        near = 1 - np.abs(away)
        weight = (near**3 * (near * (6 * near - 15) + 10)).prod(1)
        value += weight * corner_value(hashes(corner.astype(np.int64) + whole, keys, splits=1), away)
    return value


def gradient2(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return gradient noise at points (n, 3), in lattice cells, from `cells` (n, 3) on."""
    return 1.437 * blend(*placed(points, cells, 2), keys, lambda bits, away: (gradient_2(bits) * away).sum(1))


def gradient3(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return gradient noise at points (n, 3), in lattice cells, from `cells` (n, 3) on."""
    return 0.7315 * blend(*placed(points, cells, 3), keys, lambda bits, away: (icosahedron(bits) * away).sum(1))


def value2(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return value noise at points (n, 3), in lattice cells, from `cells` (n, 3) on."""
    return blend(*placed(points, cells, 2), keys, lambda bits, _: values(bits))


def value3(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return value noise at points (n, 3), in lattice cells, from `cells` (n, 3) on."""
    return blend(*placed(points, cells, 3), keys, lambda bits, _: values(bits))


def shifts(bits: Words) -> Doubles:
    """Return u - 1/2 of feature points, (n, 3), in [-1/2, 1/2)."""
    more = stir(bits, lattice.ROUND_1)
    words = np.stack([bits, more, more << np.uint32(16)], 1)
    return (words >> np.uint32(16)).astype(np.uint16).view(np.int16) / 2.0**16


def feature_bits(bits: Words) -> Words:
    """Return the hashes that the values of feature points are made of."""
    return stir(stir(bits, lattice.ROUND_1), lattice.ROUND_2)


def cellular(
    points: Doubles, keys: Sequence[int], cells: Integers | None, dimensions: int, jitter: float, reach: int
) -> tuple[Doubles, Doubles, Doubles]:
    """Return F1, F2 and the value of the nearest of all feature points of cells at most `reach` cells away."""
    at, whole = placed(points, cells, dimensions)
    distances, found = [], []
    for step in itertools.product(range(-reach, reach + 1), repeat=dimensions):
        cell = np.rint(at) + step
        bits = hashes(cell.astype(np.int64) + whole, keys, splits=1)
        distances.append(np.sqrt(((cell + jitter * shifts(bits)[:, :dimensions] - at) ** 2).sum(1)))
        found.append(values(feature_bits(bits)))
    order = np.argsort(distances, axis=0)
    first, second = np.take_along_axis(np.array(distances), order[:2], 0)
    return first, second, np.take_along_axis(np.array(found), order[:1], 0)[0]
