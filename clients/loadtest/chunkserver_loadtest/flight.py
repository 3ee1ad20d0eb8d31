"""A viewer that flies over terrain, and what it asks for: nested cubes of chunks, the finest ones around it.

The cube of LOD n is `2 * reach + 1` chunks of LOD n + 1 a side, the middle one being that in which the viewer is; so
its borders are borders of coarser chunks, and the cube inside takes whole chunks out of it. When the viewer enters
another chunk of LOD 1 some cubes move on by one, and what they have not shown before is new.

        +-----------------+
        |        2        |      LOD 2 has a hole where the cube of LOD 1 is, LOD 1 one where that of LOD 0 is
        |   +---------+   |
        |   |    1    |   |
        |   | +---+   |   |
        |   | | 0 |   |   |
        |   | +---+   |   |
        |   +---------+   |
        +-----------------+
"""

import itertools
import math
import random
from collections.abc import Iterator
from typing import Final, NamedTuple

from chunkserver_loadtest.exchange import Key

LOOKS_PER_SECOND: Final = 10
"""How often the viewer looks where it is."""
TURNS: Final = ((0.9, 23.0), (0.5, 11.0), (0.2, 5.0))
"""What sways the heading: radians, and seconds a swing."""
PITCH: Final = (0.15, 19.0)
"""What sways the pitch, likewise."""
URGENCY_LEAST: Final = 6
"""Of what a viewer asks for: 7 is for what nobody waits for."""

Point = tuple[float, float, float]


class View(NamedTuple):
    """What a viewer misses at one moment: seconds from its start, where it is (voxels), chunks in the order to ask."""

    seconds: float
    viewer: Point
    missing: list[Key]


def path(chance: random.Random, start: Point, speed: float) -> Iterator[Point]:
    """Yield where a viewer is at each look, without end: a smooth path of constant speed, voxels a second."""
    heading = chance.uniform(0, math.tau)
    phases = [chance.uniform(0, math.tau) for _ in (*TURNS, PITCH)]
    x, y, z = start
    for look in itertools.count():
        yield x, y, z
        seconds = look / LOOKS_PER_SECOND
        swings = zip(TURNS, phases, strict=False)
        turned = heading + math.fsum(
            most * math.sin(math.tau * seconds / swing + phase) for (most, swing), phase in swings
        )
        pitch = PITCH[0] * math.sin(math.tau * seconds / PITCH[1] + phases[-1])
        step = speed / LOOKS_PER_SECOND
        x += step * math.cos(turned) * math.cos(pitch)
        y += step * math.sin(pitch)
        z += step * math.sin(turned) * math.cos(pitch)


def ring(lod: int, viewer: Point, cells: int, reach: int) -> set[Key]:
    """Return the chunks of a LOD that are shown: its cube, without the cube of the next finer LOD."""
    cube = [range(2 * low, 2 * high + 2) for low, high in _box(viewer, cells << lod + 1, reach)]
    hole = [range(low, high + 1) for low, high in _box(viewer, cells << lod, reach)] if lod else [range(0)] * 3
    hidden = set(itertools.product(*hole))
    return {(lod, x, y, z) for x, y, z in itertools.product(*cube) if (x, y, z) not in hidden}


def views(points: Iterator[Point], cells: int, lods: int, reach: int) -> Iterator[View]:
    """Yield what is missing, when something is: each chunk once, the nearest first, of two as near the coarser one."""
    had: set[Key] = set()
    before: tuple[int, ...] = ()
    for look, viewer in enumerate(points):
        inside = tuple(math.floor(at / (2 * cells)) for at in viewer)
        if inside == before:
            continue
        before = inside
        shown = set().union(*(ring(lod, viewer, cells, reach) for lod in range(lods)))
        missing = sorted(shown - had, key=lambda key: (distance(key, viewer, cells), -key[0], key))
        had.update(missing)
        if missing:
            yield View(look / LOOKS_PER_SECOND, viewer, missing)


def distance(key: Key, viewer: Point, cells: int) -> float:
    """Return voxels from the viewer to the nearest point of a chunk."""
    lod, *place = key
    side = cells << lod
    return math.dist(
        (0, 0, 0), [max(low * side - at, 0.0, at - (low + 1) * side) for low, at in zip(place, viewer, strict=True)]
    )


def urgency(key: Key, viewer: Point, cells: int) -> int:
    """Return the urgency of a chunk: 0 where the viewer is, one less urgent for each doubling of the distance."""
    return min(int(distance(key, viewer, cells) / cells).bit_length(), URGENCY_LEAST)


def _box(viewer: Point, side: int, reach: int) -> list[tuple[int, int]]:
    """Return, for each axis, the first and the last chunk of `side` voxels within `reach` of the viewer's."""
    return [(math.floor(at / side) - reach, math.floor(at / side) + reach) for at in viewer]
