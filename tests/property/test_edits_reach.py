"""What an edit changes is inside `stale`, and `stale` is not much more: samples of chunks before and after strokes."""

from collections import Counter
from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits import Bricks, Edit
from chunkserver.edits.boxes import Box
from chunkserver.edits.effect import narrowed
from chunkserver.edits.reach import Range, stale
from chunkserver.grid import MASK_MAX
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import coarse_box
from tests.scale import count
from tests.strokes import OPS, SHAPES, bounds_of, field_of, no_bricks, op_of, place, shape_of

WORLDS = ("terrain", "plane", "sphere", "hills", "planet", "caves")
STROKES = 1000
STROKES_MIN = 60
LODS = 7
"""Of the world, so that the masks of LODs 0 to 5 read the next level."""
LODS_LOOKED_AT = 6
CELLS = 32
TOO_MANY = 2.0

Points = NDArray[np.int64]

COARSE = coarse_box(CELLS, MASK_MAX)


def near_surface(recipe: WorldRecipe, rng: np.random.Generator) -> tuple[float, ...]:
    """Return a lattice point of a small density, near a random place."""
    middle = rng.integers(-60, 60, 3)
    if "radius" in recipe.source:  # a ball: go to its border
        middle = (middle / np.sqrt((middle**2).sum() + 1) * (200 if "fbm" in recipe.source else 48)).astype(np.int64)
    low = middle - 24
    density = field_of(recipe)(Box(place(low), place(low + 48)))
    y, z, x = np.unravel_index(np.argmin(np.abs(density) + rng.uniform(0, 4, density.shape)), density.shape)
    return tuple(float(at) for at in np.add(low, (x, y, z)))


def samples_read(chunk: tuple[int, ...]) -> tuple[Box, Box]:
    """Return what a chunk reads: its own samples, and those of the next level that any mask takes."""
    low = [CELLS * at - 1 for at in chunk]
    coarse = [CELLS // 2 * at + first for at, first in zip(chunk, COARSE.low, strict=True)]
    own = Box(place(low), place(at + CELLS + 2 for at in low))
    last = (at + n - 1 for at, n in zip(coarse, COARSE.shape, strict=True))
    return own, Box(place(coarse), place(last))


def differing(before: Bricks, after: Bricks) -> list[Points]:
    """Return for each level the lattice points whose deltas differ, as a list of their coordinates x, y, z."""
    found = []
    for lod in range(LODS):
        points = [np.empty((0, 3), np.int64)]
        for key in {key for bricks in (before, after) for key, _ in bricks if key[0] == lod}:
            old, new = before.get(key), after.get(key)
            if old is not new:
                differs = np.not_equal(0 if old is None else old.deltas, 0 if new is None else new.deltas)
                y, z, x = np.nonzero(differs)
                points.append(np.stack([x, y, z], axis=1) + 16 * np.array(key[1:]))
        found.append(np.concatenate(points))
    return found


def chunks_changed(points: list[Points]) -> set[tuple[int, ...]]:
    """Return all chunks that read any of these points of each level."""
    found: set[tuple[int, ...]] = set()
    for lod in range(LODS_LOOKED_AT):
        near = {tuple(at) for at in np.concatenate([points[lod] // CELLS, points[lod + 1] // (CELLS // 2)])}
        for chunk in {place(np.add(at, step)) for at in near for step in product((-1, 0, 1), repeat=3)}:
            boxes = samples_read(chunk)
            if any(inside(points[lod + up], box).any() for up, box in enumerate(boxes)):
                found.add((lod, *chunk))
    return found


def inside(points, box: Box):
    return ((points >= box.low) & (points <= box.high)).all(axis=1)


def test_what_changes_is_stale_and_little_else(rng):
    listed, really = Counter[int](), Counter[int]()
    for world in WORLDS:
        recipe, bricks = WorldRecipe(7, builtin(world)), no_bricks(LODS)
        for revision in range(1, 1 + max(STROKES_MIN, count(STROKES)) // len(WORLDS)):
            op, shape = str(rng.choice(OPS)), str(rng.choice(SHAPES))
            middle = near_surface(recipe, rng)
            edit = Edit.of([op_of(rng, op, middle) | shape_of(rng, shape, middle, float(rng.uniform(2, 14)))])
            after = bricks.apply([edit], revision, field_of(recipe))
            said = set(chunks_in(stale(narrowed(edit, bricks, bounds_of(recipe)).brushes.with_points(), CELLS, LODS)))
            found = chunks_changed(differing(bricks, after))
            assert found <= said, (world, edit.source, sorted(found - said)[:3])
            listed.update(lod for lod, *_ in said)
            really.update(lod for lod, *_ in found)
            bricks = after if revision % 20 else no_bricks(LODS)
    assert min(really[lod] for lod in range(LODS_LOOKED_AT)) > 0
    assert listed.total() <= TOO_MANY * really.total()


def chunks_in(ranges: list[Range]) -> Iterator[tuple[int, ...]]:
    for at in ranges:
        if at.lod < LODS_LOOKED_AT:
            spans = (range(low, high + 1) for low, high in zip(at.low, at.high, strict=True))
            yield from ((at.lod, *chunk) for chunk in product(*spans))
