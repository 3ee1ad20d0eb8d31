"""Noise from its definition, in numpy and float64: a sum over all lattice corners near enough, in no clever order."""

import itertools
import math
from collections.abc import Sequence

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


def corner_bits(corner: Sequence[Integers], axes: Sequence[np.uint32], keys: Sequence[int], splits: int) -> Words:
    """Return the hashes of lattice corners, given as integer arrays, one an axis, that broadcast against each other."""
    total = np.zeros((), np.uint32)
    for i, axis, key in zip(corner, axes, keys, strict=True):
        word = i.view(np.uint64) + np.uint64(splits * EXPONENT % 2**64)
        low, high = word.astype(np.uint32), (word >> np.uint64(32)).astype(np.uint32)
        total = total + stir(low * axis + high * lattice.PAGE + np.uint32(key), lattice.ROUND_1)
    return stir(total, lattice.ROUND_2)


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


def simplex3(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return simplex noise at points (n, 3), in lattice cells, from `cells` (n, 3) on.

    The points are skewed in float64, so they should be small. Cells are skewed as integers: as many steps along the
    diagonal as keep them whole, the rest goes back to the points.
    """
    whole = np.zeros((1, 3), np.int64) if cells is None else cells
    diagonal = whole.sum(1, keepdims=True) // 3
    points = points + (whole.sum(1, keepdims=True) - 3 * diagonal) * np.array([1, 0, 0])
    whole = whole - (whole.sum(1, keepdims=True) - 3 * diagonal) * np.array([1, 0, 0]) + diagonal
    skewed = points + points.sum(1, keepdims=True) / 3
    value = np.zeros(len(points))
    for step in itertools.product(range(-1, 3), repeat=3):
        corner = np.floor(skewed).astype(np.int64) + step
        away = points - (corner - corner.sum(1, keepdims=True) / 6)
        bits = corner_bits(
            list((whole + corner).T.copy()), (lattice.AXIS_X, lattice.AXIS_Y, lattice.AXIS_Z), keys, splits=2
        )
        left = np.maximum(0.5 - (away**2).sum(1), 0)
        value += left**4 * (gradient_3(bits) * away).sum(1)
    return value * 76.8


def gradient_2(bits: Words) -> Doubles:
    """Return the gradient, (n, 2), that 32-bit hashes pick, by its angle."""
    angle = np.where(bits >> np.uint32(29) & np.uint32(1), 3, 1) * math.pi / 16
    swap = (bits >> np.uint32(28) & np.uint32(1)).astype(bool)
    long = np.where(bits >> np.uint32(31), -np.cos(angle), np.cos(angle))
    short = np.where(bits >> np.uint32(30) & np.uint32(1), -np.sin(angle), np.sin(angle))
    return np.stack([np.where(swap, short, long), np.where(swap, long, short)], 1)


def gradient2(points: Doubles, keys: Sequence[int], cells: Integers | None = None) -> Doubles:
    """Return gradient noise at points (n, 3), in lattice cells, from `cells` (n, 3) on: corners lie half-way."""
    whole = np.zeros((1, 3), np.int64) if cells is None else cells
    flat = points[:, [0, 2]]
    low = np.rint(flat)
    value = np.zeros(len(points))
    for step in itertools.product((0, 1), repeat=2):
        corner = low + step
        away = flat - (corner - 0.5)
        bits = corner_bits(
            [corner[:, 0].astype(np.int64) + whole[:, 0], corner[:, 1].astype(np.int64) + whole[:, 2]],
            (lattice.AXIS_X, lattice.AXIS_Z),
            (keys[0], keys[2]),
            splits=1,
        )
        near = 1 - np.abs(away)
        weight = near**3 * (near * (6 * near - 15) + 10)
        value += weight.prod(1) * (gradient_2(bits) * away).sum(1)
    return value * 1.437
