"""Which chunks an edit can change, and strokes that bounds prove to change nothing."""

import base64
from itertools import pairwise, product

import numpy as np
import pytest

from chunkserver.edits import Edit
from chunkserver.edits.boxes import Box
from chunkserver.edits.effect import narrowed
from chunkserver.edits.reach import stale
from chunkserver.grid import LATTICE_MAX
from tests.strokes import delta_of, no_bricks, random_stroke

HERE = np.zeros((1, 2, 3), np.int64)


def plane_bounds(low, high):
    """Bound the field y = 0."""
    return low[1], high[1]


def changed(edit: Edit, *known):
    """Return the boxes outside which an edit changes nothing."""
    return narrowed(edit, *known).brushes.with_points()


def flat(box: Box):
    rows = np.arange(box.low[1], box.high[1] + 1, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(rows[:, None, None], box.shape))


def ball(op: str, y: float, radius: float = 6.0, x: float = 0.0, **more) -> Edit:
    return Edit.of([{"op": op, "shape": "sphere", "center": [x, y, 0.0], "radius": radius, **more}])


NOTHING = {
    "a carve in open air": ball("carve", 20.0),
    "a fill in rock": ball("fill", -20.0),
    "an add without strength": ball("add", 0.0, strength=0.0),
    "an add of less than half a unit": ball("add", 0.0, strength=0.0004),
    "a smooth without strength": ball("smooth", 0.0, strength=0.0),
    "a flatten without strength": ball("flatten", 0.0, strength=0.0, point=[0, 0, 0], normal=[0, 1, 0]),
    "a delta of zeros": Edit.of([{"op": "delta", "min": [0, 0, 0], "size": [1, 1, 1], "values": "AAAAAA=="}]),
}


@pytest.mark.parametrize("what", NOTHING)
def test_what_changes_nothing_is_proved(what):
    edit = NOTHING[what]
    bricks = no_bricks()
    assert not len(changed(edit, bricks, plane_bounds))
    assert not list(bricks.apply([edit], 1, flat))
    assert stale(HERE[:0], 32) == []


SOMETHING = {
    "a carve below air": ball("carve", 4.0),
    "a fill below air": ball("fill", 4.0),
    "the other sign": ball("add", 0.0, strength=-0.01),
    "a smooth": ball("smooth", 0.0, strength=1.0),
    "a flatten": ball("flatten", 0.0, strength=1.0, point=[0, 0, 0], normal=[1, 1, 0]),
}


@pytest.mark.parametrize("what", SOMETHING)
def test_what_changes_something_lies_in_its_box(what):
    (box,) = changed(SOMETHING[what], no_bricks(), plane_bounds)
    for (lod, *place), brick in no_bricks(lods=1).apply([SOMETHING[what]], 1, flat):
        y, z, x = (16 * place[axis] + at for axis, at in zip((1, 2, 0), np.nonzero(brick.deltas), strict=True))
        assert lod == 0
        for at, first, last in zip((x, y, z), *box, strict=True):
            assert ((at >= first) & (at <= last)).all()


def test_a_box_is_as_small_as_can_be_shown():
    """What a carve near the surface leaves alone is the air above; a delta's box is that of its values."""
    edit = ball("carve", 0.0)
    low, high = edit.brushes.boxes[0].tolist()
    (box,) = changed(edit, no_bricks(), plane_bounds)
    assert box[1, 1] < high[1]
    assert box[0].tolist() == low
    values = np.zeros((4, 5, 6), np.int32)
    values[1:3, 2, 3:5] = 7
    delta = delta_of(np.random.default_rng(0), (10, 20, 30), (6, 4, 5)) | {"values": coded(values)}
    found = changed(Edit.of([delta | {"size": [6, 4, 5]}]), no_bricks(), plane_bounds)
    assert found.tolist() == [[[13, 21, 32], [14, 22, 32]]]


def coded(values) -> str:
    return base64.b64encode(values.astype("<i4").tobytes()).decode()


def test_deltas_are_taken_into_account():
    """Air that was filled can be carved, rock that was carved can be filled; what was carved deeper cannot."""
    for there, back, y in (("fill", "carve", 20.0), ("carve", "fill", -20.0)):
        bricks = no_bricks().apply([ball(there, y)], 1, flat)
        assert len(changed(ball(back, y), bricks, plane_bounds))
    cube = {"op": "delta", "min": [-16, -48, -16], "size": [32, 32, 32]}
    for units, proved in ((50 << 10, True), (27 << 10, False)):
        lifted = Edit.of([cube | {"values": coded(np.full(32**3, units))}])
        bricks = no_bricks().apply([lifted], 1, flat)
        assert (len(changed(ball("carve", -23.0, radius=2.0), bricks, plane_bounds)) == 0) is proved


def test_of_what_is_not_folded_nothing_is_assumed():
    carve, far = ball("carve", 20.0), ball("carve", 20.0, x=500.0)
    fill = ball("fill", 20.0)
    unfolded = changed(fill, no_bricks(), plane_bounds)
    assert len(changed(carve, no_bricks(), plane_bounds, unfolded))
    assert not len(changed(far, no_bricks(), plane_bounds, unfolded))
    both = Edit.of([stroke.model_dump(mode="json") for stroke in (*fill.strokes, *carve.strokes)])
    assert len(changed(both, no_bricks(), plane_bounds)) == 2, "strokes of one edit come one after the other"


@pytest.mark.parametrize("cells", [16, 32, 64])
def test_a_point_is_read_by_chunks_beside_it(cells):
    """LOD 0: by the chunks whose corner it is; and by all that have it within two steps, for their masks."""
    for x in range(-2 * cells, 2 * cells):
        first, *_ = stale(np.array([[[x, 0, 5], [x, 0, 5]]]), cells)
        wanted = [c for c in range(-4, 4) if c * cells - 3 <= x <= (c + 1) * cells + 3]
        assert list(range(first.low[0], first.high[0] + 1)) == wanted
        alone, *_ = stale(np.array([[[x, 0, 5], [x, 0, 5]]]), cells, lods=1)
        wanted = [c for c in range(-4, 4) if c * cells - 1 <= x <= (c + 1) * cells + 1]
        assert list(range(alone.low[0], alone.high[0] + 1)) == wanted


def test_all_levels_are_stale():
    found = stale(HERE, 32)
    assert [at.lod for at in found] == list(range(21))
    assert all(at.low == (-1, -1, -1) and at.high == (0, 0, 0) for at in found)
    assert [at.lod for at in stale(HERE, 32, lods=12)] == list(range(12))


def test_ranges_list_each_chunk_once(rng):
    boxes = []
    for _ in range(60):
        low = rng.integers(-300, 300, 3)
        boxes.append(np.stack([low, low + rng.integers(0, 90, 3)]))
    listed = [(at.lod, *place) for at in stale(np.array(boxes), 32, 6) for place in places(at)]
    wanted = {(at.lod, *place) for box in boxes for at in stale(box[None], 32, 6) for place in places(at)}
    assert len(listed) == len(set(listed))
    assert set(listed) == wanted
    assert len(stale(np.array(boxes), 32, 6)) < 0.5 * len(listed)


def places(at):
    return product(*(range(low, high + 1) for low, high in zip(at.low, at.high, strict=True)))


def test_a_row_of_boxes_is_one_range():
    row = np.array([[[x, 0, 0], [x + 20, 3, 3]] for x in range(40, 400, 20)])
    assert all(a.lod + 1 == b.lod for a, b in pairwise(stale(row, 32)))


def test_chunks_end_where_the_world_does():
    for end in (LATTICE_MAX - (1 << 12), -LATTICE_MAX + (1 << 12)):
        for at in stale(np.array([[[end - 9, 0, end - 9], [end + 9, 9, end + 9]]]), 64):
            limit = LATTICE_MAX // (64 << at.lod)
            assert all(-limit <= low <= high < limit for low, high in zip(at.low, at.high, strict=True))


@pytest.mark.parametrize("x", [0.0, 2.0**39])
def test_strokes_in_narrowed_boxes_make_the_same_deltas(x, rng):
    narrow, wide = (no_bricks(lods=4) for _ in range(2))
    smaller = 0
    for revision in range(1, 40):
        place = (x + rng.uniform(-40, 40), rng.uniform(-60, 60), rng.uniform(-40, 40))
        edit = Edit.of([random_stroke(rng, place, 6.0) for _ in range(3)])
        less = narrowed(edit, narrow, plane_bounds)
        smaller += less.brushes.points().sum() < edit.brushes.points().sum()
        narrow, wide = narrow.apply([less], revision, flat), wide.apply([edit], revision, flat)
        assert {key: brick.deltas.tobytes() for key, brick in narrow} == {
            key: brick.deltas.tobytes() for key, brick in wide
        }
    assert smaller
