"""Which chunks read what an edit can change: through the filter between levels, aprons and masks."""

import json
from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from chunkserver.edits.boxes import Box, Place
from chunkserver.grid import APRON_DEFAULT, CELLS_DEFAULT, LATTICE_MAX, LOD_MAX, MASK_MAX
from chunkserver.samples import coarse_box

assert coarse_box(CELLS_DEFAULT, MASK_MAX) == ((-APRON_DEFAULT,) * 3, (CELLS_DEFAULT // 2 + 1 + 2 * APRON_DEFAULT,) * 3)


class Range(NamedTuple):
    """Chunks of a level from `low` to `high`, both included: x, y, z."""

    lod: int
    low: Place
    high: Place


def written(ranges: Iterable[Range]) -> bytes:
    """Return the ranges as JSON: what is answered to who sends an edit, and kept with it."""
    told = [{"lod": lod, "min": low, "max": high} for lod, low, high in ranges]
    return json.dumps(told, separators=(",", ":")).encode()


def read_ranges(told: bytes) -> list[Range]:
    """Return what `written` was given."""
    return [Range(each["lod"], tuple(each["min"]), tuple(each["max"])) for each in json.loads(told)]


def stale(boxes: Sequence[Box], cells: int, lods: int = LOD_MAX + 1) -> list[Range]:
    """Return which chunks read samples that changes in these boxes of LOD 0 can change: with any mask, on all levels.

    boxes: as `changed` returns them. cells: of a chunk's side. lods: how many levels there are.

    Returns each chunk once: ranges of a level do not overlap.
    """
    if not boxes:
        return []
    # A sample of level n reads deltas less than 2^n voxels away, so changes reach from low >> n to high >> n, rounded
    # up. A chunk reads its own samples, and the next level's around its faces, in case they are borders to it: both
    # from one step before its low corner to one past its high one. The next level's steps are longer.
    levels = np.arange(lods)[:, None, None]
    read = np.minimum(levels + 1, lods - 1)
    side, limit = cells >> (read - levels), LATTICE_MAX // (cells << levels)
    edges = np.array(boxes, np.int64)
    lows = np.maximum(((edges[:, 0] >> read) - APRON_DEFAULT - 1) // side, -limit)
    highs = np.minimum((-(-edges[:, 1] >> read) + APRON_DEFAULT) // side, limit - 1)
    found = []
    for lod, ranges in enumerate(np.stack([lows, highs], axis=2).tolist()):
        here = {Box(tuple(low), tuple(high)) for low, high in ranges}
        found += [Range(lod, *box) for box in (here if len(here) == 1 else _apart(here))]
    return found


def _apart(boxes: Iterable[Box]) -> list[Box]:
    """Return boxes that do not overlap, of the same places: runs along x, joined along z, then along y."""
    places = {place for box in boxes for place in product(*map(range, box.low, (high + 1 for high in box.high)))}
    joined = [Box((x, y, z), (x, y, z)) for x, y, z in places]
    for axis in (0, 2, 1):
        joined.sort(key=lambda box: (*_without(box.low, axis), *_without(box.high, axis), box.low[axis]))
        runs: list[Box] = []
        for box in joined:
            last = runs[-1] if runs else None
            beside = last and last.high[axis] + 1 == box.low[axis]
            if last and beside and all(_without(a, axis) == _without(b, axis) for a, b in zip(last, box, strict=True)):
                runs[-1] = last.joined(box)
            else:
                runs.append(box)
        joined = runs
    return joined


def _without(place: Place, axis: int) -> tuple[int, ...]:
    return place[:axis] + place[axis + 1 :]
