"""Boxes of lattice points: where strokes, bricks and chunks meet."""

from typing import NamedTuple

Place = tuple[int, int, int]
"""A lattice point: x, y, z, in steps of its level."""


class Box(NamedTuple):
    """The lattice points of a level from `low` to `high`, both included: x, y, z, in steps of that level."""

    low: Place
    high: Place

    @property
    def shape(self) -> tuple[int, int, int]:
        """How many points along (y, z, x), the order of samples."""
        (x, y, z), (u, v, w) = self
        return v - y + 1, w - z + 1, u - x + 1

    @property
    def points(self) -> int:
        """How many there are; 0 if `high` is below `low` on an axis."""
        planes, rows, width = self.shape
        return max(planes, 0) * max(rows, 0) * max(width, 0)

    def shared(self, other: "Box") -> "Box":
        """Return the points that are in both."""
        (x, y, z), (u, v, w) = self
        (a, b, c), (d, e, f) = other
        return Box((max(x, a), max(y, b), max(z, c)), (min(u, d), min(v, e), min(w, f)))

    def joined(self, other: "Box") -> "Box":
        """Return the smallest box with the points of both."""
        (x, y, z), (u, v, w) = self
        (a, b, c), (d, e, f) = other
        return Box((min(x, a), min(y, b), min(z, c)), (max(u, d), max(v, e), max(w, f)))

    def cubes(self, bits: int) -> "Box":
        """Return the cubes of 2^bits points a side that meet the box: x, y, z in cubes."""
        (x, y, z), (u, v, w) = self
        return Box((x >> bits, y >> bits, z >> bits), (u >> bits, v >> bits, w >> bits))

    def part_of(self, other: "Box") -> tuple[slice, slice, slice]:
        """Return where the points that are in both lie in an array of `other`, (y, z, x). There must be some."""
        x, y, z = (
            slice(max(low, first) - first, min(high, last) - first + 1)
            for low, high, first, last in zip(*self, *other, strict=True)
        )
        return y, z, x

    def finer(self) -> "Box":
        """Return the points of the level below that points of this box read."""
        (x, y, z), (u, v, w) = self
        return Box((2 * x - 1, 2 * y - 1, 2 * z - 1), (2 * u + 1, 2 * v + 1, 2 * w + 1))
