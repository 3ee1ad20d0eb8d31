"""Bricks: shared between revisions, dropped when empty, in slots that are used again, filtered for coarser levels."""

import base64
import gc
from itertools import pairwise

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit, arena, draft, runs
from chunkserver.edits.arena import Arena, Held
from chunkserver.edits.boxes import Box
from chunkserver.edits.packing import packed, unpack
from chunkserver.edits.page import Page
from chunkserver.edits.pyramid import bricks_met, halve
from chunkserver.errors import StoreFull
from tests.reference import strokes_twin as twin
from tests.strokes import delta_of, dense, no_bricks, random_stroke, small_arena

FAR = 1 << 39


def flat(box: Box):
    """Return the field y = 0."""
    rows = np.arange(box.low[1], box.high[1] + 1, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(rows[:, None, None], box.shape))


def contents(bricks: Bricks) -> dict[tuple[int, ...], tuple[bytes, int, int]]:
    return {key: (brick.deltas.tobytes(), brick.low, brick.high) for key, brick in bricks}


def ball(op: str, x: float, y: float = 0.0, **more: float) -> Edit:
    return Edit.of([{"op": op, "shape": "sphere", "center": [x, y, 0.0], "radius": 4.0, **more}])


@pytest.mark.parametrize("middle", [(0.0, 0.0, 0.0), (-40.0, 3.0, -9.0), (FAR - 3.0, -4.0, 8.0 - FAR)])
def test_levels_are_filtered_as_if_all_at_once(middle, rng):
    """Edit by edit, only where something changed: the same bricks as from LOD 0 as a whole."""
    bricks = no_bricks(lods=7)
    for revision in range(1, 9):
        place = tuple(np.array(middle) + rng.uniform(-20, 20, 3))
        bricks = bricks.apply([Edit.of([random_stroke(rng, place, 5.0)])], revision, flat)
        assert_filtered(bricks)
    assert {key[0] for key, _ in bricks} >= {0, 1, 2, 3}


def assert_filtered(bricks: Bricks) -> None:
    for lod in range(1, bricks.lods):
        below = [key for key, _ in bricks if key[0] == lod - 1]
        if not below:
            assert not [key for key, _ in bricks if key[0] >= lod]
            return
        places = np.array([key[1:] for key in below])
        low, high = (places.min(axis=0) // 2 - 1) * 16, (places.max(axis=0) // 2 + 1) * 16 + 15
        box = Box(tuple(low.tolist()), tuple(high.tolist()))
        wanted = twin.filtered(dense(bricks, lod - 1, box.finer()))
        assert np.array_equal(dense(bricks, lod, box), wanted)
        assert sum(int((brick.deltas != 0).sum()) for key, brick in bricks if key[0] == lod) == (wanted != 0).sum()


def test_the_filter_is_the_twin_s(rng):
    fine = rng.integers(-(1 << 30), (1 << 30) + 1, (9, 7, 11)).astype(np.int32)
    halve(fine.reshape(-1), 7, 11, np.empty(11, np.int64), (coarse := np.empty((4, 3, 5), np.int32)).reshape(-1))
    assert np.array_equal(twin.filtered(fine), coarse)
    for (y, z, x), found in np.ndenumerate(coarse):
        wanted = twin.halved(lambda p: int(fine[p[1] + 1, p[2] + 1, p[0] + 1]), (x, y, z))
        assert found == wanted


@pytest.mark.parametrize("at_once_max", [1, 1 << 12])
def test_a_batch_is_its_edits_one_by_one(at_once_max, rng, monkeypatch):
    """at_once_max: how much is worked out by one call, lattice points of strokes and boxes of coarser levels."""
    monkeypatch.setattr(runs, "RUN_POINTS", at_once_max)
    monkeypatch.setattr(draft, "BOXES_AT_ONCE", at_once_max)
    edits = [Edit.of([random_stroke(rng, tuple(rng.uniform(-15, 15, 3)), 4.0)]) for _ in range(24)]
    one_by_one = no_bricks(lods=5)
    for revision, edit in enumerate(edits, start=1):
        one_by_one = one_by_one.apply([edit], revision, flat)
    at_once = no_bricks(lods=5).apply(edits, 24, flat)
    assert at_once.revision == one_by_one.revision == 24
    assert contents(at_once) == contents(one_by_one)


def test_all_bricks_that_are_made_were_foreseen(rng, monkeypatch):
    """Room is kept for those of `bricks_met`, and for no other one."""
    made: list[int] = []
    take = Arena.take

    def counted(arena: Arena, count: int) -> list[Held]:
        taken = take(arena, count)
        made.append(arena.taken)
        return taken

    monkeypatch.setattr(Arena, "take", counted)
    for _ in range(20):
        made.clear()
        edit = Edit.of([random_stroke(rng, tuple(rng.uniform(-30, 30, 3)), 4.0) for _ in range(6)])
        no_bricks(lods=6).apply([edit], 1, flat)
        assert 0 < max(made) <= len(bricks_met(edit.brushes.with_points(), np.arange(6)).keys)


def test_add_strokes_in_any_order(rng):
    strokes = [random_stroke(rng, (0.0, 0.0, 0.0), 4.0) for _ in range(400)]
    strokes = [stroke for stroke in strokes if stroke["op"] in ("add", "delta")]
    assert {stroke["op"] for stroke in strokes} == {"add", "delta"}
    found = [
        contents(no_bricks(lods=5).apply([Edit.of([strokes[n] for n in order])], 1, flat))
        for order in (rng.permutation(len(strokes)) for _ in range(3))
    ]
    assert found[0] == found[1] == found[2]


def test_bricks_never_change(rng):
    """Older revisions keep what they had, whatever is applied to them, and share what is the same."""
    history = [no_bricks(lods=6)]
    kept = [contents(history[0])]
    for revision in range(1, 15):
        edit = Edit.of([random_stroke(rng, tuple(rng.uniform(-30, 30, 3)), 4.0)])
        history.append(history[-1].apply([edit], revision, flat))
        kept.append(contents(history[-1]))
    assert [contents(bricks) for bricks in history] == kept
    for older, newer in pairwise(history):
        there = {key for bricks in (older, newer) for key, _ in bricks}
        assert {key for key in there if older.get(key) is not newer.get(key)} == newer.changed


def test_a_brick_knows_its_bounds():
    first = no_bricks().apply([ball("carve", 0.0)], 1, flat)
    second = first.apply([ball("carve", 0.0), ball("carve", 900.0)], 2, flat)
    for _, brick in second:
        assert brick.low == brick.deltas.min()
        assert brick.high == brick.deltas.max()


def test_what_is_undone_leaves_no_brick(rng):
    there = delta_of(rng, (-5, 14, 30), (6, 7, 8))
    values = np.frombuffer(base64.b64decode(there["values"]), "<i4")
    back = delta_of(rng, (-5, 14, 30), (6, 7, 8)) | {"values": _coded(-values)}
    bricks = no_bricks()
    slots = bricks.arena.taken
    edited = bricks.apply([Edit.of([there])], 1, flat)
    assert list(edited)
    assert edited.arena.taken > slots
    undone = edited.apply([Edit.of([back])], 2, flat)
    assert not list(undone)
    assert not list(bricks.apply([Edit.of([there, back])], 2, flat))
    del edited
    gc.collect()
    assert bricks.arena.taken == slots


def _coded(values) -> str:
    return base64.b64encode(values.astype("<i4").tobytes()).decode()


def test_slots_are_used_again():
    """A thousand revisions of one place need no more slots than two of them."""
    bricks = no_bricks(slots=128)
    for revision in range(1, 300):
        strength = 1.0 if revision % 2 else -1.0
        bricks = bricks.apply([ball("add", 3.0, strength=strength)], revision, flat)
    assert bricks.arena.taken == len(list(bricks))


def test_bricks_are_packed_when_others_want_their_slots():
    """Any number of edits in an arena for a few of them; what is read stays where it is for as long as it is kept."""
    small, large = no_bricks(slots=110), no_bricks()
    for revision in range(1, 20):
        edit = ball("carve", 100.0 * revision)
        small, large = small.apply([edit], revision, flat), large.apply([edit], revision, flat)
        reading = small.read(0, (100 * revision - 8, -8, -8), (16, 16, 16))
        slots = reading.slots[reading.slots >= 0]
        assert slots.size
        found = small.arena.deltas[slots].tobytes()
        for x in range(0, 100 * revision, 100):
            small.read(0, (x - 8, -8, -8), (16, 16, 16))
        assert small.arena.deltas[slots].tobytes() == found
    assert len(small) > 2 * 110
    assert small.arena.taken <= 110
    assert contents(small) == contents(large)


def test_what_is_worked_on_stays_where_it_is(monkeypatch):
    """Another thread that wants slots gets its turn in the middle."""
    seven = base64.b64encode(bytes([7, 0, 0, 0])).decode()
    edit = Edit.of([{"op": "delta", "min": [0, 0, 0], "size": [1, 1, 1], "values": seven}])
    bricks = Bricks(1, small_arena(2)).apply([edit], 1, flat)
    write = Page.write

    def interrupted(page: Page, arena: Arena, *given) -> None:
        for _, brick in bricks:
            brick.let_go()
        with pytest.raises(StoreFull):
            arena.take(1)
        write(page, arena, *given)

    monkeypatch.setattr(Page, "write", interrupted)
    [(_, brick)] = bricks.apply([edit], 2, flat)
    assert brick.high == 14


def test_what_is_packed_stays_where_it_is(monkeypatch, rng):
    """As above: nobody has to wait until a brick is packed."""
    memory = small_arena(1)
    [(_, brick)] = Bricks(1, memory).apply([Edit.of([delta_of(rng, (2, 3, 4), (9, 9, 9))])], 1, flat)
    deltas = brick.deltas.tobytes()

    def interrupted(values) -> bytes:
        monkeypatch.undo()
        while not brick.let_go():
            pass
        with pytest.raises(StoreFull):
            memory.take(1)
        return packed(values)

    monkeypatch.setattr(arena, "packed", interrupted)
    unpack(brick.packed, values := np.empty(4096, np.int32))
    assert values.tobytes() == brick.deltas.tobytes() == deltas


def test_the_weight_of_packed_bricks_is_known():
    bricks = no_bricks(slots=200)
    for revision in range(1, 20):
        bricks = bricks.apply([ball("carve", 100.0 * revision)], revision, flat)
    arena = bricks.arena
    packed = sum(len(brick.packed) + 512 for _, brick in bricks)
    assert arena.weight == packed
    bricks = bricks.apply([ball("add", 100.0, strength=1.0)], 20, flat)
    gone = len(bricks.changed) * 512
    assert packed - 40 * gone < arena.weight < packed, "what has changed is not packed yet"
    del bricks
    gc.collect()
    assert (arena.weight, arena.taken) == (0, 0)


def test_a_full_arena_changes_nothing():
    bricks = no_bricks(slots=60).apply([ball("carve", 0.0)], 1, flat)
    kept, taken = contents(bricks), bricks.arena.taken
    with pytest.raises(StoreFull, match="60"):
        bricks.apply([ball("carve", 100.0 * at) for at in range(1, 9)], 2, flat)
    gc.collect()
    assert contents(bricks) == kept
    assert bricks.arena.taken == taken


def test_an_arena_may_lie_in_memory_of_others():
    memory = bytearray(64 * 4096 * 4)
    arena = Arena(np.frombuffer(memory, np.int32).reshape(64, 4096))
    bricks = Bricks(3, arena).apply([ball("carve", 0.0)], 1, flat)
    mapped = np.frombuffer(memory, np.int32).reshape(64, 4096)
    for _, brick in bricks:
        assert np.array_equal(mapped[brick.hold().slot], brick.deltas.reshape(-1))
        assert brick.deltas.any()


def test_a_failing_field_changes_nothing():
    bricks = Bricks(3, small_arena(64))

    def failing(_: Box):
        raise RuntimeError("no field")

    with pytest.raises(RuntimeError):
        bricks.apply([ball("carve", 0.0)], 1, failing)
    gc.collect()
    assert bricks.arena.taken == 0
