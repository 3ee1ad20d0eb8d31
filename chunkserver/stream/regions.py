"""Where a subscriber looks: boxes of voxels, and how coarse the chunks are that it shows there."""

from typing import NamedTuple

Place = tuple[int, int, int]


class Box(NamedTuple):
    """Lattice points of LOD 0 from `low` to `high`, both included: x, y, z in voxels."""

    low: Place
    high: Place

    def meets(self, other: "Box") -> bool:
        """Return whether a point is in both."""
        (x, y, z), (u, v, w) = self
        (a, b, c), (d, e, f) = other
        return x <= d and a <= u and y <= e and b <= v and z <= f and c <= w

    def joined(self, other: "Box") -> "Box":
        """Return the smallest box that holds both."""
        (x, y, z), (u, v, w) = self
        (a, b, c), (d, e, f) = other
        return Box((min(x, a), min(y, b), min(z, c)), (max(u, d), max(v, e), max(w, f)))


class Region(NamedTuple):
    """A box, and the coarsest level of the chunks that matter in it."""

    box: Box
    lod: int


Regions = frozenset[Region]
