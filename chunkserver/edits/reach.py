"""Which chunks read what an edit can change: through the filter between levels, aprons and masks."""

import json
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.boxes import Place
from chunkserver.edits.cubes import joined, met
from chunkserver.grid import APRON_DEFAULT, CELLS_DEFAULT, LATTICE_MAX, LOD_MAX, MASK_MAX
from chunkserver.samples import coarse_box

_Ints = NDArray[np.int64]
_TOLD: Final = '{"lod":%d,"min":[%d,%d,%d],"max":[%d,%d,%d]}'

assert coarse_box(CELLS_DEFAULT, MASK_MAX) == ((-APRON_DEFAULT,) * 3, (CELLS_DEFAULT // 2 + 1 + 2 * APRON_DEFAULT,) * 3)


class Range(NamedTuple):
    """Chunks of a level from `low` to `high`, both included: x, y, z."""

    lod: int
    low: Place
    high: Place


def written(ranges: Iterable[Range]) -> bytes:
    """Return the ranges as JSON: what is answered to who sends an edit, and kept with it."""
    told = ",".join([_TOLD % (lod, *low, *high) for lod, low, high in ranges])
    return f"[{told}]".encode()


def read_ranges(told: bytes) -> list[Range]:
    """Return what `written` was given."""
    return [Range(each["lod"], tuple(each["min"]), tuple(each["max"])) for each in json.loads(told)]


def stale(boxes: _Ints, cells: int, lods: int = LOD_MAX + 1) -> list[Range]:
    """Return which chunks read samples that changes in these boxes of LOD 0 can change: with any mask, on all levels.

    boxes: (n, 2, 3) int64, as `changed` returns them. cells: of a chunk's side. lods: how many levels there are.

    Returns each chunk once: ranges of a level do not overlap.
    """
    # A sample of level n reads deltas less than 2^n voxels away, so changes reach from low >> n to high >> n, rounded
    # up. A chunk reads its own samples, and the next level's around its faces, in case they are borders to it: both
    # from one step before its low corner to one past its high one. The next level's steps are longer.
    levels = np.arange(lods)[:, None, None]
    read = np.minimum(levels + 1, lods - 1)
    side, limit = cells >> (read - levels), LATTICE_MAX // (cells << levels)
    chunks = np.empty((lods, *boxes.shape), np.int64)
    np.maximum(((boxes[:, 0] >> read) - APRON_DEFAULT - 1) // side, -limit, out=chunks[:, :, 0])
    np.minimum((-(-boxes[:, 1] >> read) + APRON_DEFAULT) // side, limit - 1, out=chunks[:, :, 1])
    if len(boxes) == 1:
        return [Range(lod, (x, y, z), (u, v, w)) for lod, (((x, y, z), (u, v, w)),) in enumerate(chunks.tolist())]
    again = np.zeros(chunks.shape[:2], np.bool_)
    again[:, 1:] = (chunks[:, 1:] == chunks[:, :-1]).all(axis=(2, 3))
    groups = np.broadcast_to(levels[:, :, 0], again.shape)[~again]
    found = joined(met(groups, chunks[~again], 0).keys).tolist()
    return [Range(lod, (x, y, z), (u, v, w)) for lod, x, y, z, u, v, w in found]
