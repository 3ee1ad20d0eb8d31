"""What to draw while chunks are still on their way: docs/level-of-detail.md, "While chunks load"."""

from collections.abc import Collection, Iterator, Set
from itertools import product
from typing import NamedTuple

from chunkserver_client.edits import ChunkRange, is_stale
from chunkserver_client.layers import FittedChunk
from chunkserver_client.mesh import ChunkKey


class Swap(NamedTuple):
    """Chunks that take the place of others, all at once."""

    old: frozenset[FittedChunk]
    new: frozenset[FittedChunk]


def swaps(drawn: Set[FittedChunk], wanted: Set[FittedChunk]) -> list[Swap]:
    """Return the steps from what is drawn to what is wanted: the smallest that leave no hole, in any order.

    Each is done when all chunks of `new` have come. Both sets are selections, or what steps have made of one.
    """
    changed: dict[ChunkKey, list[FittedChunk]] = {}
    for chunk in drawn ^ wanted:
        changed.setdefault(chunk.key, []).append(chunk)
    found = []
    for group in _groups(changed.keys()):
        chunks = frozenset(chunk for key in group for chunk in changed[key])
        found.append(Swap(chunks & drawn, chunks & wanted))
    return found


def redraws(drawn: Set[FittedChunk], stale: Collection[ChunkRange]) -> list[frozenset[FittedChunk]]:
    """Return which of the chunks that are drawn an edit may have changed, in groups that do not touch each other.

    drawn: a selection. stale: of the edit.

    Fetch a group with `min_revision`, and draw all of it anew at once: then borders fit at all times.
    """
    changed = {chunk.key: chunk for chunk in drawn if is_stale(chunk.key, stale)}
    return [frozenset(changed[key] for key in group) for group in _groups(changed.keys())]


def _groups(keys: Set[ChunkKey]) -> list[list[ChunkKey]]:
    """Return the keys in groups: those of different groups do not touch."""
    leader = {key: key for key in keys}

    def first(key: ChunkKey) -> ChunkKey:
        while leader[key] != key:
            leader[key] = key = leader[leader[key]]
        return key

    lods = sorted({key.lod for key in keys})
    for key in keys:
        for other in _touched(key, [lod for lod in lods if lod >= key.lod]):
            if other in leader:
                leader[first(other)] = first(key)
    groups: dict[ChunkKey, list[ChunkKey]] = {}
    for key in keys:
        groups.setdefault(first(key), []).append(key)
    return list(groups.values())


def _touched(key: ChunkKey, lods: list[int]) -> Iterator[ChunkKey]:
    """Yield the chunks of some levels, none finer, that a chunk touches or lies in."""
    for lod in lods:
        up = lod - key.lod
        axes = [{place + step >> up for step in (-1, 0, 1)} for place in key[1:]]
        for place in product(*axes):
            yield ChunkKey(lod, *place)
