"""An edit that could make a delta overflow is refused; none that is taken makes one pass."""

import numpy as np
import pytest

from chunkserver.edits import Edit
from chunkserver.edits.headroom import FIELD_UNITS, ROUNDING_UNITS, Headroom
from chunkserver.edits.strokes import DELTA_MAX, UNITS_MAX, UNITS_PER_VOXEL
from chunkserver.errors import BadStroke
from tests.strokes import delta_of, no_bricks, shape_of

ROOM = (DELTA_MAX - 2 * 65536 * UNITS_PER_VOXEL) // UNITS_MAX
"""How many strokes of the greatest strength one place takes."""


def add(count: int, x: float = 0.0, strength: float = 1024.0, op: str = "add") -> Edit:
    stroke = {"op": op, "shape": "sphere", "center": [x, 8.0, 8.0], "radius": 3.0, "strength": strength}
    return Edit.of([stroke] * count)


def lowest(box):
    return np.full(box.shape, -65536, np.float32)


def test_what_would_pass_the_limit_is_refused():
    room = Headroom(no_bricks())
    room.take(add(ROOM - 1), 1)
    with pytest.raises(BadStroke) as refused:
        room.take(add(2), 2)
    assert refused.value.values["path"] == "strokes.1"
    room.take(add(1), 2)
    with pytest.raises(BadStroke):
        room.take(add(1, strength=-0.001), 3)
    room.take(add(ROOM, x=100.0), 3)


def test_what_is_folded_counts_as_it_is():
    """Back and forth comes to nothing, which is known once it is folded."""
    bricks = no_bricks(lods=1)
    room, there, back = Headroom(bricks), add(400), add(400, strength=-1024.0)
    room.take(there, 1)
    room.take(back, 2)
    with pytest.raises(BadStroke):
        room.take(there, 3)
    room.settle(bricks.apply([there], 1, lowest))
    with pytest.raises(BadStroke):
        room.take(there, 3)
    room.settle(bricks.apply([there, back], 2, lowest))
    room.take(there, 3)


def test_cuts_need_no_room():
    room = Headroom(no_bricks())
    room.take(add(ROOM), 1)
    for op in ("carve", "fill"):
        room.take(Edit.of([{"op": op, "shape": "sphere", "center": [0.0, 8.0, 8.0], "radius": 3.0}] * 1000), 2)


def test_smoothing_takes_from_the_brick_beside():
    """x = 16 begins another brick: what is smoothed in there reads x = 15."""
    room = Headroom(no_bricks())
    room.take(add(ROOM - 1, x=8.0), 1)
    room.take(add(1, x=19.0, strength=1.0, op="smooth"), 2)
    room.take(add(1, x=24.0, strength=1000.0), 3)
    with pytest.raises(BadStroke):
        room.take(add(1, x=24.0), 4)


@pytest.mark.parametrize("field", [-65536.0, 65536.0])
def test_nothing_that_was_taken_passes_the_limit(field, rng):
    """As much as is taken away from what the field has, and now and then something else."""
    edits, room = [], Headroom(no_bricks())
    for revision in range(1, 90):
        smooth = {"op": "smooth", "strength": 0.3} | shape_of(rng, "sphere", (10.0, 8.0, 8.0), 3.0)
        some = Edit.of([smooth, delta_of(rng, (7, 7, 7), (3, 3, 3))])
        edits.append(some if revision % 10 == 0 else add(20, x=8.0, strength=np.sign(field) * 1024.0))
        try:
            room.take(edits[-1], revision)
        except BadStroke:
            edits.pop()
    assert len(edits) < 60
    bricks = no_bricks(lods=4).apply(edits, 60, lambda box: np.full(box.shape, field, np.float32))
    largest = max(max(-brick.low, brick.high) for _, brick in bricks)
    assert 0.5 * DELTA_MAX < largest <= DELTA_MAX


def test_float32_rounds_by_no_more_than_is_allowed_for():
    largest = np.float32((DELTA_MAX - FIELD_UNITS) / UNITS_PER_VOXEL)
    assert float(np.spacing(largest)) * UNITS_PER_VOXEL / 2 + 0.5 < ROUNDING_UNITS
