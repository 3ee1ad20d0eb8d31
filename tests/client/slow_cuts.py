"""A twin of `LevelOfDetail`, written from docs/level-of-detail.md alone: sets of keys, integers, no cleverness."""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

Key = tuple[int, int, int, int]
Row = tuple[int, int, int, int, int]
"""lod, x, y, z and the mask."""

STEPS = [step for step in product((-1, 0, 1), repeat=3) if any(step)]


class World(NamedTuple):
    """What the page's formulas speak of; the box is (low, high)."""

    cells: int
    lods: int
    box: tuple[Sequence[int], Sequence[int]]


class Rung(NamedTuple):
    reach: int
    distances: list[int]


class Chosen(NamedTuple):
    split: set[Key]
    roots: set[Key]
    rows: set[Row]


VOXELS_MAX = 1 << 40
"""The bounds of all worlds."""

NOBODY = Chosen(set(), set(), set())


def parent(key: Key) -> Key:
    lod, x, y, z = key
    return lod + 1, x >> 1, y >> 1, z >> 1


def root_of(key: Key, top: int) -> Key:
    return key if key[0] == top else root_of(parent(key), top)


def children(key: Key) -> Iterator[Key]:
    lod, x, y, z = key
    for a, b, c in product((0, 1), repeat=3):
        yield lod - 1, 2 * x + a, 2 * y + b, 2 * z + c


def beside(key: Key, step: Sequence[int]) -> Key:
    lod, x, y, z = key
    return lod, x + step[0], y + step[1], z + step[2]


def corners(world: World, key: Key) -> list[tuple[int, int]]:
    side = world.cells << key[0]
    return [(side * place, side * (place + 1)) for place in key[1:]]


def in_box(world: World, key: Key) -> bool:
    return all(a < high and b > low for (a, b), low, high in zip(corners(world, key), *world.box, strict=True))


def squared_distance(world: World, key: Key, at: Sequence[int], ahead: Sequence[int], most: int) -> int:
    total = 0
    for (low, high), here, way in zip(corners(world, key), at, ahead, strict=True):
        there = here + max(-most, min(way, most))
        total += max(low - max(here, there), min(here, there) - high, 0) ** 2
    return total


def ladder(world: World, errors: Sequence[float] | None, view: dict[str, Any]) -> list[Rung]:
    errors = errors or [0.25 * 2**lod for lod in range(world.lods)]
    sharpness = view["screen_pixels"] / (2 * math.tan(math.radians(view["fov_degrees"]) / 2)) / view["error_pixels"]
    sides = [world.cells << lod for lod in range(world.lods)]
    most = [0]
    most += [int(min(max(errors[: lod + 1]) * sharpness, 16 * sides[lod])) for lod in range(1, world.lods)]
    rungs = [Rung(view["reach"], [distance * 3**k // 4**k for distance in most]) for k in range(9)]
    for finest in range(1, world.lods):
        rungs.append(Rung(view["reach"], [d if lod > finest else 0 for lod, d in enumerate(rungs[8].distances)]))
    reach = view["reach"] * 3 // 4
    while reach > sides[-1] // 2:
        rungs.append(Rung(reach, [0] * world.lods))
        reach = reach * 3 // 4
    return [*rungs, Rung(sides[-1] // 2, [0] * world.lods)]


def cut(world: World, rung: Rung, at: Sequence[int], ahead: Sequence[int], before: Chosen) -> Chosen:
    """Return the chunks for a viewer. before: what was shown, or nobody."""

    def near(key: Key, distance: int, was: bool) -> bool:
        most = distance + distance // 4 if was else distance
        return squared_distance(world, key, at, ahead, distance) < most * most

    top = world.lods - 1
    side = world.cells << top
    around = [
        range((min(p, p + a) - 2 * rung.reach) // side, (max(p, p + a) + 2 * rung.reach) // side + 1)
        for p, a in zip(at, [max(-rung.reach, min(a, rung.reach)) for a in ahead], strict=True)
    ]
    roots = {
        key
        for x, y, z in product(*around)
        if in_box(world, key := (top, x, y, z))
        and all(low >= -VOXELS_MAX and high <= VOXELS_MAX for low, high in corners(world, key))
        and near(key, rung.reach, key in before.roots)
    }
    split: set[Key] = set()
    level = roots
    for lod in range(top, 0, -1):
        close = {key for key in level if near(key, rung.distances[lod], True)}
        split |= {key for key in close if near(key, rung.distances[lod], key in before.split)}
        level = {child for key in close for child in children(key) if in_box(world, child)}
    for lod in range(1, top):
        for key in [key for key in split if key[0] == lod]:
            for step in STEPS:
                above = parent(beside(key, step))
                if root_of(above, top) in roots and in_box(world, above):
                    split.add(above)
    there = roots | {child for key in split for child in children(key) if in_box(world, child)}
    leaves = there - split
    return Chosen(split, roots, {(*key, mask(key, leaves)) for key in leaves})


def mask(key: Key, leaves: set[Key]) -> int:
    found = 0
    for face in range(6):
        step = [0, 0, 0]
        step[face // 2] = 1 if face % 2 else -1
        found |= (parent(beside(key, step)) in leaves) << face
    return found


def select(
    world: World,
    rungs: list[Rung],
    at: Sequence[int],
    ahead: Sequence[int],
    before: tuple[int, Chosen] | None,
    most: int,
) -> tuple[int, Chosen]:
    """Return the finest rung whose cut is not too large, and the cut."""
    number, was = before or (0, NOBODY)
    while number and has_room(world, rungs[number - 1], at, ahead, most):
        number -= 1
    for finest in range(number, len(rungs)):
        found = cut(world, rungs[finest], at, ahead, was)
        if len(found.rows) <= most:
            return finest, found
    raise AssertionError("the last rung has 64 chunks at most")


def has_room(world: World, rung: Rung, at: Sequence[int], ahead: Sequence[int], most: int) -> bool:
    wider = Rung(rung.reach + rung.reach // 4, [distance + distance // 4 for distance in rung.distances])
    return len(cut(world, wider, at, ahead, NOBODY).rows) <= most
