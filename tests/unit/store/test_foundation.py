"""Foundations: laid in steps, while others write; the edits of the last span can still be read."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from itertools import islice

import pytest

from chunkserver.errors import BadParameter, StoreError, StoreFull, WorldGone
from chunkserver.store import Store
from chunkserver.store.foundation import PART_BYTES_MAX, REVISION_MAX
from chunkserver.store.portions import STEP_ROWS_MAX
from tests.unit.store.edits import A, B, bodies, draft, foundation, rows, swept, written
from tests.unit.store.worlds import world

SECONDS_MAX = 20.0
MANY = [(b"%05d" % number, b"x" * (number % 7)) for number in range(3 * STEP_ROWS_MAX + 1)]


def test_a_foundation_stands_for_the_edits_up_to_its_revision(store):
    written(store.log, *(draft(b"%d" % number) for number in range(1, 6)), draft(b"b", B.epoch))
    assert foundation(store.log) == (0, {})
    store.log.lay(A.epoch, 2, [(b"name", b"old"), (b"other", b"")])
    assert foundation(store.log) == (2, {b"name": b"old", b"other": b""})
    assert (store.log.floor(A.epoch), bodies(store.log)[:2]) == (0, [(1, b"1"), (2, b"2")])
    store.log.lay(A.epoch, 4, iter([(b"\0name", bytes(10_000))]))
    assert foundation(store.log) == (4, {b"\0name": bytes(10_000)})
    assert (store.log.floor(A.epoch), bodies(store.log, after=2)) == (2, [(3, b"3"), (4, b"4"), (5, b"5")])
    with pytest.raises(BadParameter, match="after is 1; edits up to 2") as caught:
        store.log.read(A.epoch, 1)
    assert caught.value.values == {"after": 1, "floor": 2}
    assert (bodies(store.log, B.epoch), foundation(store.log, B.epoch)) == ([(1, b"b")], (0, {}))


def test_revisions_go_on_behind_a_floor(store):
    written(store.log, draft(b"1"), draft(b"2"))
    for _ in range(2):
        store.log.lay(A.epoch, 2, [])
    for _ in range(2):
        assert (store.log.revision(A.epoch), store.log.floor(A.epoch), bodies(store.log, after=2)) == (2, 2, [])
        swept(store.log)
    assert written(store.log, draft(b"3"))[0].revision == 3


def test_a_log_without_edits_begins_with_a_foundation(store):
    store.log.lay(A.epoch, 1000, [(b"name", b"content")])
    assert (store.log.revision(A.epoch), store.log.floor(A.epoch)) == (1000, 1000)
    assert foundation(store.log) == (1000, {b"name": b"content"})
    assert written(store.log, draft(b"1"))[0].revision == 1001
    assert bodies(store.log, after=1000) == [(1001, b"1")]


@pytest.mark.parametrize("revision", [-1, 0, REVISION_MAX + 1])
def test_where_a_log_cannot_begin(store, revision):
    with pytest.raises(BadParameter, match=rf"is {revision}; it lies in \[1, {REVISION_MAX}\]"):
        store.log.lay(A.epoch, revision, [])
    assert foundation(store.log) == (0, {})


@pytest.mark.parametrize("revision", [1, 4])
def test_what_can_be_no_foundation(store, revision):
    written(store.log, *(draft() for _ in range(3)))
    store.log.lay(A.epoch, 2, [(b"name", b"kept")])
    with pytest.raises(BadParameter, match=f"is {revision}; it lies in .2, 3."):
        store.log.lay(A.epoch, revision, [])
    assert foundation(store.log) == (2, {b"name": b"kept"})


def test_a_part_that_is_too_large(store):
    written(store.log, draft())
    with pytest.raises(BadParameter, match=f"part b'name' .* has {PART_BYTES_MAX + 1} bytes"):
        store.log.lay(A.epoch, 1, [(b"name", bytes(PART_BYTES_MAX - 3))])
    store.log.lay(A.epoch, 1, [(b"name", bytes(PART_BYTES_MAX - 4))])
    assert foundation(store.log)[0] == 1


def test_others_write_while_a_foundation_is_laid(store):
    written(store.log, draft(b"1"))

    def parts():
        for number, part in enumerate(MANY):
            if number % STEP_ROWS_MAX == 0:
                written(store.log, draft(b"more"), draft(b"b", B.epoch))
                assert foundation(store.log) == (0, {}), "the one before, until all of it is there"
            yield part

    store.log.lay(A.epoch, 1, parts())
    assert foundation(store.log) == (1, dict(MANY))
    assert (store.log.revision(A.epoch), store.log.revision(B.epoch)) == (5, 4)


def test_who_waits_to_write_comes_between_two_steps(store):
    """However fast the steps follow each other."""
    written(store.log, draft(b"1"))
    laying, over = threading.Event(), threading.Event()

    def parts():
        number = 0
        while not over.is_set():
            yield b"%09d" % number, b""
            number += 1
            if number > STEP_ROWS_MAX:
                laying.set()

    with ThreadPoolExecutor(1) as threads:
        laid = threads.submit(store.log.lay, A.epoch, 1, parts())
        try:
            assert laying.wait(SECONDS_MAX)
            for number in range(20):
                assert written(store.log, draft(b"x"))[0].revision == number + 2
            assert not laid.done()
        finally:
            over.set()
        laid.result(SECONDS_MAX)


def test_edits_that_came_before_a_log_could_begin_with_a_foundation(store):
    def parts():
        yield b"name", b"content"
        written(store.log, draft(b"1"))

    with pytest.raises(BadParameter, match=r"is 9; it lies in \[1, 1\]"):
        store.log.lay(A.epoch, 9, parts())
    assert (foundation(store.log), bodies(store.log)) == ((0, {}), [(1, b"1")])
    swept(store.log)
    assert (rows(store)["foundations"], rows(store)["parts"]) == (0, 0)


def test_a_foundation_that_fails_changes_nothing(store):
    written(store.log, draft(b"1", key="k"))

    def parts():
        yield from MANY
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.log.lay(A.epoch, 1, parts())
    assert (foundation(store.log), bodies(store.log)) == ((0, {}), [(1, b"1")])
    assert rows(store)["parts"] > STEP_ROWS_MAX
    swept(store.log)
    assert rows(store) == {
        "logs": 2, "edits": 1, "clients": 0, "keys": 1, "foundations": 0, "parts": 0, "unswept": 0
    }  # fmt: skip
    store.log.lay(A.epoch, 1, MANY)
    assert foundation(store.log) == (1, dict(MANY))


def test_a_world_that_is_deleted_while_its_foundation_is_laid(store):
    written(store.log, draft(b"1"))
    coming = iter(MANY)

    def parts():
        yield from islice(coming, STEP_ROWS_MAX + 1)
        store.catalogue.delete("a")
        assert not store.log.sweep(), "what is being written is left alone"
        yield from coming

    with pytest.raises(WorldGone):
        store.log.lay(A.epoch, 1, parts())
    assert next(coming), "nor are all others asked for"
    assert swept(store.log)
    left = rows(store)
    assert (left["edits"], left["foundations"], left["parts"], left["unswept"]) == (0, 0, 0, 0)


def test_what_is_not_finished_after_a_restart_is_swept(folder):
    first = Store(folder)
    first.catalogue.create(A)
    written(first.log, draft(b"1"))

    def parts():
        yield from MANY
        first.close()

    with pytest.raises(Exception, match="closed"):
        first.log.lay(A.epoch, 1, parts())
    with closing(Store(folder)) as second:
        assert (rows(second)["foundations"], foundation(second.log)) == (1, (0, {}))
        assert swept(second.log)
        assert (rows(second)["foundations"], rows(second)["parts"]) == (0, 0)


def test_a_foundation_is_read_a_few_parts_at_a_time(store, monkeypatch):
    written(store.log, draft(b"1"))
    store.log.lay(A.epoch, 1, MANY)
    reads = 0
    read = store._database.read

    def counted():
        nonlocal reads
        reads += 1
        return read()

    monkeypatch.setattr(store._database, "read", counted)
    revision, parts = store.log.foundation(A.epoch)
    found = [next(parts)]
    assert (revision, reads) == (1, 2)
    written(store.log, draft(b"2"))
    found += parts
    assert (found, reads) == (MANY, 6)


def test_a_foundation_that_is_replaced_while_it_is_read(store):
    written(store.log, draft(b"1"))
    store.log.lay(A.epoch, 1, MANY)
    _, parts = store.log.foundation(A.epoch)
    next(parts)
    store.log.lay(A.epoch, 1, MANY)
    with pytest.raises(StoreError, match="was replaced while it was read"):
        list(parts)


def test_lays_take_turns(store):
    """The second begins when the first has ended; both are right."""
    written(store.log, draft(b"1"), draft(b"2"))
    begun, go = threading.Event(), threading.Event()

    def parts():
        begun.set()
        assert go.wait(SECONDS_MAX)
        yield b"name", b"first"

    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(store.log.lay, A.epoch, 1, parts())
        try:
            assert begun.wait(SECONDS_MAX)
            second = threads.submit(store.log.lay, A.epoch, 2, [(b"name", b"second")])
        finally:
            go.set()
        first.result(SECONDS_MAX)
        second.result(SECONDS_MAX)
    assert (foundation(store.log), store.log.floor(A.epoch)) == ((2, {b"name": b"second"}), 1)


def test_no_world_no_foundation(store):
    gone = world("gone")
    with pytest.raises(WorldGone):
        store.log.lay(gone.epoch, 1, [])
    with pytest.raises(WorldGone):
        store.log.foundation(gone.epoch)


def test_a_disk_that_gets_full_while_a_foundation_is_laid(folder):
    """What was written of it makes room again."""
    with closing(Store(folder)) as kept:
        kept.catalogue.create(A)
        written(kept.log, draft(b"1"))
        writer = kept._database._writer
        writer.pragma("max_page_count", writer.pragma("page_count") + 600)
        with pytest.raises(StoreFull):
            kept.log.lay(A.epoch, 1, ((b"%d" % number, bytes(8000)) for number in range(1000)))
        assert (foundation(kept.log), bodies(kept.log)) == ((0, {}), [(1, b"1")])
        swept(kept.log)
        kept.log.lay(A.epoch, 1, ((b"%d" % number, bytes(8000)) for number in range(200)))
        assert len(foundation(kept.log)[1]) == 200
