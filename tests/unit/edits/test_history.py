"""Edits of a world in any order of takes, writes, drops and folds: which reached each chunk last, what is in it."""

import base64
import gc
from collections.abc import Iterator
from itertools import islice, product
from typing import Any

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit, History
from chunkserver.edits import history as history_file
from chunkserver.edits.arena import Arena
from chunkserver.edits.history import Taken
from chunkserver.edits.packing import packed
from chunkserver.edits.pyramid import bricks_met
from chunkserver.errors import BadStroke, Overloaded, StoreError, StoreFull
from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, builtin
from tests.strokes import bounds_of, edited, field_of, no_bricks, random_stroke, small_arena

PLANE = WorldRecipe(0, builtin("plane"))
CELLS = 16
LODS = 4
KEYS = [ChunkKey(lod, *place) for lod in range(LODS) for place in product((-2, -1, 0, 1), repeat=3)]


def history_of(slots: int = 1 << 12) -> History:
    return History(no_bricks(LODS, slots), bounds_of(PLANE), CELLS)


def ball(x: float = 0.0, y: float = -4.0, op: str = "carve", **more: Any) -> Edit:
    return Edit.of([{"op": op, "shape": "sphere", "center": [x, y, 0.0], "radius": 4.0, **more}])


def fold(history: History, count: int = 100) -> Bricks:
    """Fold some edits and publish them."""
    edits = history.unfolded(count)
    bricks = history.bricks.apply(edits, history.bricks.revision + len(edits), field_of(PLANE))
    history.publish(bricks)
    return bricks


def write(history: History, edit: Edit) -> int:
    """Take an edit and write it."""
    history.written(history.take(edit), history.revision + 1)
    return history.revision


def within(ranges: Any, key: ChunkKey) -> bool:
    return any(
        lod == key.lod and all(a <= at <= b for a, at, b in zip(low, key[1:], high, strict=True))
        for lod, low, high in ranges
    )


@pytest.mark.parametrize("groups_max", [history_file.WRITTEN_GROUPS_MAX, 0])
def test_the_last_edit_of_every_chunk_is_known_at_any_time(rng, monkeypatch, groups_max):
    monkeypatch.setattr(history_file, "WRITTEN_GROUPS_MAX", groups_max)
    history = history_of()
    taken: list[Taken] = []
    written: list[Taken] = []
    waited = 0

    def last(count):
        return {
            key: max((at + 1 for at, each in enumerate(written[:count]) if within(each.stale, key)), default=0)
            for key in KEYS
        }

    for _ in range(80):
        deed = rng.choice(["take", "take", "write", "write", "drop", "fold"])
        if deed == "take":
            middle = tuple(rng.uniform(-16, 16, 3))
            taken.append(history.take(Edit.of([random_stroke(rng, middle, float(rng.uniform(1, 4)))])))
        elif deed == "fold":
            fold(history, int(rng.integers(1, 4)))
        elif taken and deed == "write":
            written.append(taken.pop(0))
            history.written(written[-1], len(written))
        elif taken:
            history.dropped(taken.pop(0))
        waited += history.revision > history.bricks.revision
        assert history.revision == len(written)
        assert {key: history.last_edit(key) for key in KEYS} == last(len(written))
        assert {key: history.last_folded(key) for key in KEYS} == last(history.bricks.revision)
    assert waited > 5
    assert history.bricks.revision > 5


def test_a_chunk_is_as_the_last_of_its_folded_edits_has_left_it(rng):
    """Whatever came behind that edit has changed none of its samples."""
    history = history_of()
    at_revision = [history.bricks]
    for _ in range(8):
        write(history, Edit.of([random_stroke(rng, tuple(rng.uniform(-20, 20, 3)), float(rng.uniform(1, 4)))]))
        at_revision.append(fold(history))
    older = 0
    for key in KEYS[:: 1 + 2]:
        last = history.last_folded(key)
        older += 0 < last < history.revision
        for coarser in (0, 63) if key.lod + 1 < LODS else (0,):
            now, then = (edited(PLANE, bricks, key, CELLS, coarser) for bricks in (history.bricks, at_revision[last]))
            assert now.density.tobytes() == then.density.tobytes()
            if now.coarse is not None and then.coarse is not None:
                assert now.coarse.tobytes() == then.coarse.tobytes()
    assert older > 3


def test_an_edit_without_effect_has_a_revision_and_makes_nothing_stale():
    history = history_of()
    taken = history.take(ball(y=40.0))
    assert not taken.stale
    assert not len(taken.boxes)
    history.written(taken, 1)
    assert not any(map(history.last_edit, KEYS))
    fold(history)
    assert history.bricks.revision == history.revision == 1


def test_what_is_not_folded_yet_counts_for_what_an_edit_changes():
    """A fill in open air, and then a carve of it before the fill is folded: both have an effect."""
    for folded in (False, True):
        history = history_of()
        write(history, ball(y=40.0, op="fill"))
        if folded:
            fold(history)
        assert history.take(ball(y=40.0)).stale


def test_edits_that_are_dropped_do_not_count():
    history = history_of()
    history.dropped(history.take(ball(y=40.0, op="fill")))
    assert not history.take(ball(y=40.0)).stale
    assert history.bricks.arena.reserved == 0, "one was dropped, the other changes nothing"
    low = history.take(ball()).edit.brushes.boxes
    assert history.bricks.arena.reserved == len(bricks_met(low, np.arange(LODS)).keys)


def test_of_two_that_are_the_same_one_can_be_dropped():
    history = history_of()
    first, second = history.take(ball()), history.take(ball())
    history.dropped(second)
    assert history.waiting == 1
    history.written(first, 1)
    fold(history)
    assert (history.waiting, history.bricks.arena.reserved) == (0, 0)


def test_revisions_have_no_hole():
    history = history_of()
    taken = history.take(ball())
    with pytest.raises(AssertionError, match="revision 2 follows 0"):
        history.written(taken, 2)


def test_too_many_unfolded_edits_are_refused(monkeypatch):
    monkeypatch.setattr(history_file, "UNFOLDED_MAX", 3)
    history = history_of()
    write(history, ball())
    write(history, ball())
    history.take(ball())
    with pytest.raises(Overloaded, match="3 edits"):
        history.take(ball())
    fold(history, 1)
    history.take(ball())


def edits_far_apart() -> Iterator[Edit]:
    return (ball(x=1000.0 * at) for at in range(1_000_000))


@pytest.mark.parametrize("folds", [False, True])
def test_an_edit_that_was_taken_can_be_folded(folds):
    """There is room to work it out, or it is refused for now: also beside those of another world in the same arena."""
    arena = small_arena(600)
    histories = [History(Bricks(LODS, arena), bounds_of(PLANE), CELLS) for _ in range(2)]
    refused: list[dict[str, Any]] = []
    for edit, history in product(islice(edits_far_apart(), 60), histories):
        try:
            write(history, edit)
        except Overloaded as error:
            refused.append(error.values)
        if folds:
            fold(history)
    assert bool(refused) is not folds
    assert all(values["bricks"] > values["free"] for values in refused)
    for history in histories:
        fold(history)
        assert history.bricks.revision == history.revision > 1
    assert (arena.reserved, arena.promised) == (0, 0)
    assert sum(len(history.bricks) for history in histories) > (600 if folds else 40)
    if not folds:
        write(histories[0], ball())


def test_an_edit_that_can_never_be_folded_is_refused_for_good():
    history = history_of(slots=70)
    large = Edit.of([{"op": "carve", "shape": "sphere", "center": [0.0, 0.0, 0.0], "radius": 40.0}])
    with pytest.raises(StoreFull, match="more room than for 70"):
        history.take(large)
    write(history, ball())
    with pytest.raises(StoreFull, match="more room than for 70"):  # also while another edit waits
        history.take(large)


def test_edits_that_take_too_much_memory_are_refused():
    bricks = Bricks(LODS, Arena(small_arena().deltas, weight_max=100_000))
    history, refusals, said = History(bricks, bounds_of(PLANE), CELLS), [], []
    for at, edit in zip(range(60), edits_far_apart(), strict=False):
        try:
            write(history, edit)
        except StoreFull as error:
            refusals.append(at)
            said.append(error.values)
        fold(history)
    assert refusals == list(range(refusals[0], 60))
    assert refusals[0] > 2
    assert said == [{"bytes_max": 100_000}] * len(said)
    assert write(history, ball(y=40.0)) == history.revision, "what reaches no chunk is taken"


def test_the_weight_of_a_world_goes_with_it():
    history = history_of()
    arena = history.bricks.arena
    for edit in islice(edits_far_apart(), 5):
        write(history, edit)
        fold(history)
    assert arena.weight > 5 * 512
    del history
    gc.collect()
    assert (arena.weight, arena.taken) == (0, 0)


def kept_of(history: History, kept: dict[bytes, bytes], *, everything: bool = False) -> None:
    """Bring what was kept up to date."""
    change = history.change(everything=everything)
    if change.since is None:
        kept.clear()
    for name in change.gone():
        del kept[name]
    kept.update(change.parts())


def state_of(history: History) -> Any:
    bricks = {key: (brick.deltas.tobytes(), brick.low, brick.high) for key, brick in history.bricks}
    return bricks, [history.last_edit(key) for key in KEYS], history.revision


def test_what_was_kept_now_and_then_is_restored(rng):
    """Change by change, with bricks that come and go; and it goes on from there."""
    history = history_of()
    kept: dict[bytes, bytes] = {}
    undone = 0
    for turn in range(12):
        middle = tuple(rng.uniform(-16, 16, 3))
        stroke = random_stroke(rng, middle, 3.0)
        write(history, Edit.of([stroke]))
        if turn % 3 == 2:
            values = rng.integers(-99, 99, (3, 3, 3)).astype("<i4")
            for sign in (1, -1):
                coded = base64.b64encode((sign * values).tobytes()).decode()
                write(history, Edit.of([{"op": "delta", "min": [80, 80, 80], "size": [3, 3, 3], "values": coded}]))
                fold(history)
                kept_of(history, kept)
                undone += history.bricks.get((0, 5, 5, 5)) is None
        fold(history)
        if turn % 2:
            kept_of(history, kept)
            again = History.restored(kept.items(), no_bricks(LODS), history.revision, bounds_of(PLANE), CELLS)
            assert state_of(again) == state_of(history)
            assert again.bricks.arena.taken == len(again.bricks)
            change = again.change()
            assert (list(change.parts()), list(change.gone()), change.since) == ([], [], history.revision)
            later = Edit.of([random_stroke(rng, middle, 3.0)])
            write(again, later)
            write(history, later)
            fold(history)
            fold(again)
            assert state_of(again) == state_of(history)
    assert undone == 4
    whole: dict[bytes, bytes] = {}
    kept_of(history, kept)
    kept_of(history, whole, everything=True)
    assert kept == whole


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (b"", b"", "part that is none"),
        (b"X" + bytes(25), b"", "kind"),
        (b"B" + bytes(25), b"1234", "part that is none"),
        (b"R" + bytes(25), b"1234", "cannot be unpacked"),
        (b"R" + bytes(25), packed(np.zeros(65, np.int64)), "not 512"),
    ],
)
def test_what_is_no_part_is_refused(name, content, said):
    with pytest.raises(StoreError, match=said):
        History.restored([(name, content)], no_bricks(LODS), 1, bounds_of(PLANE), CELLS)


def test_overflow_is_refused_and_nothing_noted():
    history = history_of()
    stroke = {"op": "add", "shape": "sphere", "center": [0.0, -4.0, 0.0], "radius": 4.0, "strength": 1024.0}
    high, many = Edit.of([stroke]), Edit.of([stroke] * 60)
    for _ in range(850):
        write(history, high)
        fold(history)
    with pytest.raises(BadStroke, match="pass"):
        history.take(many)
    assert history.revision == 850
    assert history.bricks.arena.reserved == 0
    write(history, ball(op="add", strength=-1024.0))


def test_a_log_that_is_read_again_gives_the_same(rng):
    strokes = [random_stroke(rng, tuple(rng.uniform(-16, 16, 3)), float(rng.uniform(1, 4))) for _ in range(12)]
    first, again = history_of(), history_of()
    for stroke in strokes:
        taken = first.take(Edit.of([stroke]))
        first.written(taken, first.revision + 1)
        fold(first)
        again.logged(taken.edit.source, taken.told)
    while again.bricks.revision < again.revision:
        fold(again, 5)
    assert [first.last_edit(key) for key in KEYS] == [again.last_folded(key) for key in KEYS]
    kept = [{key: brick.deltas.tobytes() for key, brick in history.bricks} for history in (first, again)]
    assert kept[0] == kept[1] != {}
    assert again.bricks.arena.reserved == 0
    assert np.any([first.last_edit(key) for key in KEYS])


def test_an_edit_that_has_much_around_it_can_be_folded():
    """Coarser bricks read many that do not change: they are worked out a few at a time."""
    history, edits = history_of(slots=512), []
    for x, y in product(range(12), repeat=2):
        box = {"shape": "box", "center": [16.0 * x + 8.0, 16.0 * y + 8.0, 24.0], "half_extents": [8.0, 8.0, 24.0]}
        edits.append(Edit.of([{"op": "add", "strength": 3.0, **box}]))
        write(history, edits[-1])
        fold(history)
    smooth = {"op": "smooth", "strength": 1.0, "shape": "sphere", "radius": 8.4}
    balls = product((24.0, 72.0, 120.0, 168.0), repeat=2)
    edits.append(Edit.of([{**smooth, "center": [x, y, 24.0]} for x, y in balls]))
    write(history, edits[-1])
    found = {key: brick.deltas.tobytes() for key, brick in fold(history)}
    at_once = Bricks(LODS, small_arena()).apply(edits, len(edits), field_of(PLANE))
    assert found == {key: brick.deltas.tobytes() for key, brick in at_once}
