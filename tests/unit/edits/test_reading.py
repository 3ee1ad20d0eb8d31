"""What a chunk reads is the deltas of its box, wherever bricks begin."""

import numpy as np
import pytest

from chunkserver.edits import Edit
from chunkserver.edits.boxes import Box
from chunkserver.edits.reading import apply
from tests.strokes import delta_of, dense, no_bricks

FAR = (1 << 39) - 8


@pytest.mark.parametrize("shape", [(35, 35, 35), (19, 3, 7), (1, 1, 1), (5, 21, 40)])
@pytest.mark.parametrize("middle", [(0, 0, 0), (-37, 5, -1), (FAR, -FAR, FAR)])
@pytest.mark.parametrize("deep", [False, True])
def test_deltas_are_added_where_they_are(deep, middle, shape, rng):
    """deep: in a hole that is so far down that float32 cannot hold its deltas."""
    strokes = [
        delta_of(rng, tuple(at + int(by) for at, by in zip(middle, rng.integers(-20, 20, 3), strict=True)), size)
        for size in ((7, 20, 3), (33, 5, 5), (9, 9, 9), (2, 2, 40))
    ]
    if deep:
        strokes.append({"op": "carve", "shape": "sphere", "center": [at + 0.3 for at in middle], "radius": 12.0})
    bricks = no_bricks(lods=4).apply([Edit.of(strokes)], 1, lambda box: np.full(box.shape, -60_000 * deep, np.float32))
    assert any(brick.high > 1 << 24 for _, brick in bricks) is deep
    for lod in range(4):
        for _ in range(10):
            low = tuple((at >> lod) + int(by) for at, by in zip(middle, rng.integers(-24, 8, 3), strict=True))
            (planes, rows, width), (x, y, z) = shape, low
            box = Box(low, (x + width - 1, y + planes - 1, z + rows - 1))
            deltas = dense(bricks, lod, box)
            field = (rng.normal(size=shape) * 10.0 ** rng.integers(-6, 5)).astype(np.float32)
            wanted = (field.astype(np.float64) + deltas * 2.0**-10).astype(np.float32)
            reading = bricks.read(lod, low, shape)
            apply(found := field.copy(), bricks.arena.deltas, reading)
            assert np.array_equal(found, wanted)
            assert reading.low <= deltas.min()
            assert reading.high >= deltas.max()


def test_nothing_is_read_where_nothing_was_edited(rng):
    bricks = no_bricks().apply(
        [Edit.of([delta_of(rng, (0, 0, 0), (4, 4, 4))])], 1, lambda box: np.zeros(box.shape, np.float32)
    )
    for low in ((-36, 0, 0), (200, 0, 0), (5000, 5000, 5000)):
        reading = bricks.read(0, low, (35, 35, 35))
        assert reading.low == reading.high == 0
        density = rng.normal(size=(35, 35, 35)).astype(np.float32)
        apply(after := density.copy(), bricks.arena.deltas, reading)
        assert np.array_equal(after, density)
