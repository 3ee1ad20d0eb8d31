"""Ranges of chunks that are stale, and how few of them say it: what is told is never less than what is so."""

import json
from collections.abc import Iterable
from typing import NamedTuple

from chunkserver.stream.limits import RANGES_MAX
from chunkserver.stream.regions import Box


class Range(NamedTuple):
    """Chunks of a level: `box` has the first and the last, both included, in chunks."""

    lod: int
    box: Box

    def voxels(self, cells: int) -> Box:
        """Return the voxels of these chunks, borders included. cells: of a chunk's side."""
        side = cells << self.lod
        (x, y, z), (u, v, w) = self.box
        return Box((x * side, y * side, z * side), ((u + 1) * side, (v + 1) * side, (w + 1) * side))


def read_ranges(told: bytes) -> tuple[Range, ...]:
    """Return the ranges of JSON as an edit's answer has it: a list of objects with `lod`, `min` and `max`."""
    found = json.loads(told or b"[]")
    return tuple(Range(each["lod"], Box(tuple(each["min"]), tuple(each["max"]))) for each in found)


def bounded(ranges: Iterable[Range]) -> tuple[Range, ...]:
    """Return ranges that cover these, each once, in order: at most RANGES_MAX, or one for each level."""
    found = tuple(dict.fromkeys(ranges))
    if len(found) <= RANGES_MAX:
        return found
    levels: dict[int, Box] = {}
    for lod, box in found:
        levels[lod] = levels.get(lod, box).joined(box)
    return tuple(Range(lod, box) for lod, box in levels.items())


def written(each: Range) -> bytes:
    """Return a range as JSON."""
    lod, (low, high) = each
    return b'{"lod":%d,"min":[%d,%d,%d],"max":[%d,%d,%d]}' % (lod, *low, *high)
