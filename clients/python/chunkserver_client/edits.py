"""Edits: what the server says of one that was written, and of those in its log; docs/api.md, "Edits"."""

import base64
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import CELLS_BUILT, LOD_MAX, REVISION_MAX, VOXELS_MAX, ChunkKey, Triple

Stroke = Mapping[str, Any]
"""As docs/edits/strokes.md has them: {"op": "carve", "shape": "sphere", "center": [0, 0, 0], "radius": 6}."""

PLACE_MAX: Final = VOXELS_MAX // min(CELLS_BUILT)
DELTA_MAX: Final = 1 << 20
"""Of one value of a `delta`."""


class ChunkRange(NamedTuple):
    """Chunks of a level from `low` to `high`, both included: x, y, z."""

    lod: int
    low: Triple
    high: Triple

    def holds(self, key: ChunkKey) -> bool:
        """Return whether a chunk is one of these."""
        return key.lod == self.lod and all(
            first <= place <= last for place, first, last in zip(key[1:], self.low, self.high, strict=True)
        )

    def among(self, keys: Collection[ChunkKey]) -> Iterator[ChunkKey]:
        """Return those of the keys that are these chunks. Few of many are looked up, and not looked for."""
        spans = [range(first, last + 1) for first, last in zip(self.low, self.high, strict=True)]
        if math.prod(map(len, spans)) > len(keys):
            return filter(self.holds, keys)
        return filter(keys.__contains__, (ChunkKey(self.lod, *place) for place in product(*spans)))


@dataclass(frozen=True, slots=True)
class WrittenEdit:
    """An edit that is durable.

    revision: of the world with this edit.
    duplicate: it had been written before, under the same key; this is its first answer.
    stale: the chunks that it may have changed, each once.
    """

    revision: int
    duplicate: bool
    stale: tuple[ChunkRange, ...]


@dataclass(frozen=True, slots=True)
class LoggedEdit:
    """An edit of a world's log. strokes: as they were sent, defaults written out. stale: as in `WrittenEdit`."""

    revision: int
    strokes: tuple[Stroke, ...]
    stale: tuple[ChunkRange, ...]


def is_stale(key: ChunkKey, stale: Iterable[ChunkRange]) -> bool:
    """Return whether a chunk is in any of these ranges."""
    return any(chunks.holds(key) for chunks in stale)


def delta_stroke(low: Sequence[int], values: NDArray[np.integer[Any]]) -> Stroke:
    """Return the stroke that adds integers to the densities of a box of lattice points.

    low: x, y, z of the first point, in voxels.
    values: (y, z, x), integers, units of 1/1024 voxel: above 0 is towards air.

    Raises `ValueError` for another shape or type, and for values beyond 2^20.
    """
    array = np.asarray(values)
    if array.ndim != 3 or not array.size or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"values are {array.shape} {array.dtype}: expected (y, z, x) integers")
    if max(-int(array.min()), int(array.max())) > DELTA_MAX:
        raise ValueError(f"values go from {array.min()} to {array.max()}: they lie within {DELTA_MAX}")
    planes, rows, width = array.shape
    packed = base64.b64encode(array.astype("<i4").tobytes()).decode()
    return {"op": "delta", "min": [int(at) for at in low], "size": [width, planes, rows], "values": packed}


def read_written(json: Json) -> WrittenEdit:
    """Read what was answered to an edit. Raises `BadAnswer`, which says where, if something is wrong."""
    return WrittenEdit(json["revision"].decimal(1, REVISION_MAX), json["duplicate"].boolean(), _ranges(json["stale"]))


def read_log(json: Json, after: int) -> tuple[list[LoggedEdit], int]:
    """Read a part of a log, and the world's revision. Raises `BadAnswer` if it does not go on behind `after`."""
    revision = json["revision"].decimal(0, REVISION_MAX)
    edits = []
    for number, row in enumerate(json["edits"], after + 1):
        strokes = tuple(stroke.members() for stroke in row["strokes"])
        edits.append(LoggedEdit(row["revision"].decimal(number, number), strokes, _ranges(row["stale"])))
    if not edits and revision > after:
        json["edits"].refuse(f"edits from {after + 1} to {revision}")
    return edits, revision


def _ranges(json: Json) -> tuple[ChunkRange, ...]:
    return tuple(_range(row) for row in json)


def _range(json: Json) -> ChunkRange:
    low, high = (_place(json[name]) for name in ("min", "max"))
    if any(last < first for first, last in zip(low, high, strict=True)):
        json.refuse("a range with its low end first")
    return ChunkRange(json["lod"].integer(0, LOD_MAX), low, high)


def _place(json: Json) -> Triple:
    x, y, z = (json[axis].integer(-PLACE_MAX, PLACE_MAX) for axis in range(3))
    return x, y, z
