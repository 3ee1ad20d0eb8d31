"""Strokes fold to the deltas that the plain-Python twin finds, to the unit."""

import numpy as np
import pytest

from chunkserver.edits import Edit
from chunkserver.edits.boxes import Box
from tests.reference import strokes_twin as twin
from tests.strokes import OPS, SHAPES, delta_of, dense, no_bricks, op_of, shape_of

PLACES = {"origin": (0, 0, 0), "negative": (-19, -7, -3), "far": (1 << 39, -(1 << 39) - 5, (1 << 39) - 9)}


def wavy(p) -> float:
    """Return a field of its own: float32, as fields are."""
    x, y, z = p
    return float(np.float32((y % 64 - 20) * 0.75 + (x * 7 + z * 13) % 32 / 8 - 2))


def wavy_box(box: Box):
    grid = [[[wavy((x, y, z)) for x in span(box, 0)] for z in span(box, 2)] for y in span(box, 1)]
    return np.array(grid, np.float32)


def span(box: Box, axis: int) -> range:
    return range(box.low[axis], box.high[axis] + 1)


def agree(strokes) -> None:
    """Assert that an edit makes the deltas that the twin finds, stroke by stroke, and no other ones."""
    known: dict[tuple[int, ...], int] = {}
    bricks = no_bricks(lods=1)
    for number, stroke in enumerate(strokes, start=1):
        edit = Edit.of([stroke])
        low, high = twin.box(stroke)
        assert edit.brushes.boxes.tolist() == [[list(low), list(high)]]
        bricks = bricks.apply([edit], number, wavy_box)
        was = dict(known)
        for p in twin.points(stroke):
            known[p] = twin.folded(stroke, wavy, lambda q: was.get(q, 0), p)  # noqa: B023 - called here only
    assert any(known.values())
    for p in {p: 0 for p, delta in known.items() if delta}:
        x, y, z = p
        brick = bricks.get((0, x >> 4, y >> 4, z >> 4))
        assert brick is not None
        assert brick.deltas[y & 15, z & 15, x & 15] == known[p], p
    count = int(sum((brick.deltas != 0).sum() for _, brick in bricks))
    assert count == len([delta for delta in known.values() if delta])


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("op", OPS)
def test_every_op_with_every_shape(op, shape, where, rng):
    middle = PLACES[where]
    before = delta_of(rng, middle, (6, 5, 4))
    agree([before, op_of(rng, op, middle) | shape_of(rng, shape, middle, 3.0)])


def test_a_delta_lies_in_the_order_of_samples(rng):
    agree([delta_of(rng, (-3, 14, 30), (2, 3, 4)), delta_of(rng, (-2, 15, 31), (5, 2, 3))])


def test_a_carve_is_a_maximum():
    """Once more changes nothing, and two carves, or two fills, may come in any order."""
    for op in ("carve", "fill"):
        a, b = ({"op": op, "shape": "sphere", "center": [x, 0.5, 0.0], "radius": 5.0} for x in (0.0, 6.3))
        first, second = (no_bricks(lods=3).apply([Edit.of(strokes)], 1, wavy_box) for strokes in ([a, b, a, a], [b, a]))
        box = Box((-20, -20, -20), (25, 20, 20))
        assert np.array_equal(dense(first, 0, box), dense(second, 0, box))
        assert dense(first, 0, box).any()


def test_nothing_is_changed_outside_the_margin():
    carve = {"op": "carve", "shape": "sphere", "center": [0.0, -100.0, 0.0], "radius": 6.0}
    bricks = no_bricks().apply([Edit.of([carve])], 1, lambda box: np.full(box.shape, -100, np.float32))
    inside = dense(bricks, 0, Box((-12, -112, -12), (12, -88, 12)))
    assert (inside > 0).all()
    assert int(sum((brick.deltas != 0).sum() for (lod, *_), brick in bricks if lod == 0)) == inside.size


def test_the_formulas_in_one_place_by_hand():
    """A ball of radius 4 in rock 10 voxels deep: 4 voxels of air in its middle, its border where it is said to be."""
    carve = {"op": "carve", "shape": "sphere", "center": [0.0, 0.0, 0.0], "radius": 4.0}
    add = {"op": "add", "shape": "sphere", "center": [0.0, 0.0, 0.0], "radius": 4.0, "strength": 2.0}
    bricks = no_bricks().apply([Edit.of([carve])], 1, lambda box: np.full(box.shape, -10, np.float32))
    row = dense(bricks, 0, Box((0, 0, 0), (9, 0, 0))).reshape(-1)
    assert row.tolist() == [1024 * delta for delta in (14, 13, 12, 11, 10, 9, 8, 7, 6, 0)]
    row = dense(bricks.apply([Edit.of([add])], 2, wavy_box), 0, Box((0, 0, 0), (5, 0, 0))).reshape(-1)
    soft = [2048 * u * u * (3 - 2 * u) for u in (1, 0.75, 0.5, 0.25, 0, 0)]
    assert row.tolist() == [1024 * delta - by for delta, by in zip((14, 13, 12, 11, 10, 9), soft, strict=True)]
