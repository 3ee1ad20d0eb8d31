"""What nothing refers to is deleted a little at a time, and what has to outlive it does."""

from contextlib import closing
from itertools import pairwise

import pytest

from chunkserver.errors import BadParameter, WorldGone
from chunkserver.store import Store, sweeping
from chunkserver.store.portions import STEP_BYTES_MAX, STEP_ROWS_MAX
from tests.unit.store.edits import A, B, bodies, draft, foundation, refusal, rows, swept, written
from tests.unit.store.worlds import world


def floor_at(kept, revision):
    for _ in range(2):
        kept.lay(A.epoch, revision, [])


@pytest.fixture
def tiny_steps(monkeypatch):
    monkeypatch.setattr(sweeping, "STEP_ROWS_MAX", 1)


def test_edits_go_up_to_the_floor(store):
    written(store.log, *(draft(b"%d" % number) for number in range(1, 6)), draft(b"b", B.epoch))
    store.log.lay(A.epoch, 3, [(b"1", b"")])
    swept(store.log)
    assert rows(store)["edits"] == 6, "below the floor there is none yet"
    store.log.lay(A.epoch, 4, [(b"2", b"")])
    assert (rows(store)["edits"], rows(store)["parts"]) == (6, 2)
    assert swept(store.log)
    assert (rows(store)["edits"], rows(store)["parts"], rows(store)["foundations"]) == (3, 1, 1)
    assert (bodies(store.log, after=3), bodies(store.log, B.epoch)) == ([(4, b"4"), (5, b"5")], [(1, b"b")])
    assert foundation(store.log) == (4, {b"2": b""})
    assert not store.log.sweep()


@pytest.mark.usefixtures("tiny_steps")
def test_seqs_and_keys_outlive_their_edits(store):
    drafts = [draft(b"1", client="c", seq=4), draft(b"2", client="c", seq=6), draft(b"3", client="d", seq=1, key="k")]
    first = written(store.log, *drafts)
    floor_at(store.log, 3)
    swept(store.log)
    for names in ({"key": "k"}, {"key": "k", "client": "d", "seq": 1}, {"key": "k", "client": "c", "seq": 5}):
        assert written(store.log, draft(b"3", **names)) == [first[2]._replace(duplicate=True)], "its own answer"
    for seq in (4, 5, 6):
        (again,) = written(store.log, draft(b"whatever", client="c", seq=seq))
        assert again == (2, b"", True), "no later than the floor"
    assert (store.log.mark(A.epoch, "c"), store.log.mark(A.epoch, "d")) == (6, 1)
    written(store.log, draft(b"4", client="c", seq=9))
    assert "seq 8" in refusal(store.log, draft(b"5", client="c", seq=8)).message
    floor_at(store.log, 4)
    swept(store.log)
    assert store.log.mark(A.epoch, "d") == 1, "a later floor does not forget who was silent since"
    assert written(store.log, draft(b"4", client="c", seq=9)) == [(4, b"", True)]


@pytest.mark.usefixtures("tiny_steps")
def test_answers_are_right_after_each_step(store):
    """Edits that are there are known as they were; those that went, as what is kept of them."""
    drafts = [draft(b"%d" % number, client="c", seq=2 * number, key=str(number)) for number in range(1, 6)]
    nameless = [draft(b"%d" % number, client="c", seq=2 * number) for number in range(1, 6)]
    outcomes = [one._replace(duplicate=True) for one in written(store.log, *drafts)]
    floor_at(store.log, 4)
    gone = 0
    while True:
        assert written(store.log, *drafts) == outcomes, "a key has its answer"
        for number, one in enumerate(nameless, 1):
            expected = outcomes[number - 1] if number > gone else (gone, b"", True)
            assert written(store.log, one) == [expected]
        assert store.log.mark(A.epoch, "c") == 10
        for number in range(1, 6):
            odd = draft(b"odd", client="c", seq=2 * number - 1)
            if number <= gone:
                assert written(store.log, odd) == [(gone, b"", True)]
            else:
                assert isinstance(refusal(store.log, odd), BadParameter)
        if not store.log.sweep():
            break
        gone = 5 - rows(store)["edits"]
    assert gone == 4


def test_a_step_is_small(store):
    """In rows, and in bytes; a large edit goes alone."""
    written(store.log, *(draft() for _ in range(2 * STEP_ROWS_MAX)))
    written(store.log, *(draft(bytes(STEP_BYTES_MAX // 5)) for _ in range(6)), draft(bytes(STEP_BYTES_MAX)), draft())
    floor_at(store.log, 2 * STEP_ROWS_MAX + 8)
    counts = []
    while store.log.sweep():
        counts.append(rows(store)["edits"])
    steps = [before - after for before, after in pairwise(counts) if before != after]
    assert steps == [STEP_ROWS_MAX, STEP_ROWS_MAX, 2, 2, 2, 1, 1]


@pytest.mark.usefixtures("tiny_steps")
def test_a_log_goes_with_its_world(store):
    """At once for all who ask; its rows a little at a time, and those of a new world of the same id stay."""
    written(store.log, draft(b"1", client="c", seq=1, key="k"), draft(b"2"), draft(b"b", B.epoch, key="k"))
    store.log.lay(A.epoch, 1, [(b"name", b"content"), (b"other", b"")])
    store.catalogue.delete("a")
    assert rows(store)["edits"] == 3, "a deletion is short"
    again = world("a")
    store.catalogue.create(again)
    written(store.log, draft(b"new", again.epoch, client="c", seq=1, key="k"))
    store.log.lay(again.epoch, 1, [(b"name", b"new")])
    while True:
        for asked in (store.log.read, store.log.revision, store.log.floor, store.log.foundation, store.log.mark):
            more = {store.log.read: (0,), store.log.mark: ("c",)}.get(asked, ())
            with pytest.raises(WorldGone):
                asked(A.epoch, *more)
        (refused,) = store.log.append([draft(b"3")])
        assert isinstance(refused, WorldGone)
        assert bodies(store.log, again.epoch) == [(1, b"new")]
        assert foundation(store.log, again.epoch) == (1, {b"name": b"new"})
        assert written(store.log, draft(b"new", again.epoch, client="c", seq=1, key="k"))[0].duplicate
        if not store.log.sweep():
            break
    assert rows(store) == {"logs": 2, "edits": 2, "clients": 1, "keys": 2, "foundations": 1, "parts": 1, "unswept": 0}


def test_a_restart_goes_on_with_it(folder):
    with closing(Store(folder)) as first:
        first.catalogue.create(A)
        written(first.log, *(draft(client="c", seq=number, key=str(number)) for number in range(2 * STEP_ROWS_MAX)))
        first.catalogue.delete("a")
        assert first.log.sweep()
    with closing(Store(folder)) as second:
        assert rows(second)["edits"] == STEP_ROWS_MAX
        assert swept(second.log)
        assert set(rows(second).values()) == {0}


def test_a_sweep_looks_at_each_edit_a_few_times(store):
    """However many clients, keys and edits there are. SQLite counts its own instructions."""
    counted = 0

    def another():
        nonlocal counted
        counted += 1
        return False

    edits = 12 * STEP_ROWS_MAX
    written(store.log, *(draft(client=f"c{number}", seq=number, key=str(number)) for number in range(edits)))
    floor_at(store.log, edits - 1)
    store._database._writer.set_progress_handler(another, 100)
    swept(store.log)
    store._database._writer.set_progress_handler(None)
    assert edits / 10 < counted < edits, counted / edits
    assert (store.log.mark(A.epoch, "c0"), store.log.mark(A.epoch, f"c{edits - 1}")) == (0, edits - 1)
    assert rows(store)["edits"] == 1
