"""Where a session looks, and which chunks messages speak of."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from chunkserver_client.edits import ChunkRange
from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import LOD_MAX, VOXELS_MAX, ChunkKey, Triple


class Region(NamedTuple):
    """A box of voxels from `low` to `high`, both included: x, y, z. lod: the coarsest level of the chunks shown in it.

    Edits that may change a chunk of this level, or of a finer one, that meets the box are in the region.
    """

    low: Triple
    high: Triple
    lod: int = LOD_MAX

    def check(self) -> "Region":
        """Return this. Raises `ValueError`, which names it, if it is no region."""
        within = all(
            -VOXELS_MAX <= first <= last <= VOXELS_MAX for first, last in zip(self.low, self.high, strict=True)
        )
        if not within or not 0 <= self.lod <= LOD_MAX:
            raise ValueError(f"{self}: low is nowhere above high, both within 2^40 voxels, and lod is 0 to {LOD_MAX}")
        return self

    def written(self) -> Mapping[str, Any]:
        """Return it as JSON's values."""
        return {"min": self.low, "max": self.high, "lod": self.lod}

    def holds(self, key: ChunkKey, cells: int) -> bool:
        """Return whether it tells of edits in a chunk. cells: of a chunk's side."""
        side = cells << key.lod
        return key.lod <= self.lod and all(
            place * side <= last and first <= (place + 1) * side
            for place, first, last in zip(key[1:], self.low, self.high, strict=True)
        )


def read_ranges(found: Json) -> tuple[ChunkRange, ...]:
    """Return ranges of chunks. Raises `BadAnswer`."""
    return tuple(
        ChunkRange(each["lod"].integer(0, LOD_MAX), _place(each["min"]), _place(each["max"])) for each in found
    )


def _place(found: Json) -> Triple:
    values = found.elements()
    if len(values) != 3 or not all(type(value) is int and -VOXELS_MAX <= value <= VOXELS_MAX for value in values):
        found.refuse("three integers within 2^40")
    return values[0], values[1], values[2]
