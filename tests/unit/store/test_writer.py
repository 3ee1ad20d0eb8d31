"""The thread that writes edits, beside a log that waits until it is told to go on."""

import threading
from concurrent.futures import wait
from contextlib import closing

import pytest

from chunkserver.errors import BadParameter, Overloaded, StoreError
from chunkserver.store import Draft, Outcome, writer
from chunkserver.store.writer import Writer

SECONDS_MAX = 20.0


class StubLog:
    """Keeps what it is given; says nothing before it is let through."""

    def __init__(self):
        self.batches = []
        self.begun = threading.Semaphore(0)
        self.let_through = threading.Semaphore(0)
        self.fault = None

    def append(self, drafts):
        self.batches.append([draft.strokes for draft in drafts])
        self.begun.release()
        assert self.let_through.acquire(timeout=SECONDS_MAX)
        if self.fault:
            raise self.fault
        return [Outcome(1, draft.strokes) if draft.strokes != b"bad" else BadParameter("it is bad") for draft in drafts]

    def wait_begun(self):
        assert self.begun.acquire(timeout=SECONDS_MAX)


@pytest.fixture
def log():
    return StubLog()


@pytest.fixture
def opened(log):
    one = Writer(log.append)
    yield one
    log.let_through.release(1000)
    one.close()


def draft(body=b"x"):
    return Draft(epoch="e", digest=b"", strokes=body, stale=b"")


def test_nothing_is_answered_before_the_log_has_it(opened, log):
    future = opened.submit(draft())
    log.wait_begun()
    assert not future.done()
    log.let_through.release()
    assert future.result(SECONDS_MAX) == (1, b"x", False)


def test_all_that_wait_are_one_transaction(opened, log):
    futures = [opened.submit(draft(b"first"))]
    log.wait_begun()
    futures += [opened.submit(draft(b"%d" % number)) for number in range(5)]
    log.let_through.release(2)
    wait(futures, SECONDS_MAX)
    assert log.batches == [[b"first"], [b"0", b"1", b"2", b"3", b"4"]]


@pytest.mark.parametrize(("limit", "value"), [("DRAFTS_AT_ONCE_MAX", 2), ("BYTES_AT_ONCE_MAX", 5)])
def test_a_transaction_is_bounded(opened, log, monkeypatch, limit, value):
    monkeypatch.setattr(writer, limit, value)
    log.let_through.release(10)
    futures = [opened.submit(draft(b"12")) for _ in range(9)]
    wait(futures, SECONDS_MAX)
    assert sum(map(len, log.batches)) == 9
    assert max(map(len, log.batches)) <= 2


@pytest.mark.parametrize(("limit", "value"), [("DRAFTS_WAITING_MAX", 3), ("BYTES_WAITING_MAX", 7)])
def test_too_much_is_refused_at_once(opened, log, monkeypatch, limit, value):
    monkeypatch.setattr(writer, limit, value)
    first = opened.submit(draft(b"12"))
    log.wait_begun()
    taken = [opened.submit(draft(b"12")) for _ in range(3)]
    with pytest.raises(Overloaded) as caught:
        opened.submit(draft(b"12"))
    assert caught.value.values == {"waiting": 3}
    log.let_through.release(2)
    wait([first, *taken], SECONDS_MAX)
    log.let_through.release()
    assert opened.submit(draft(b"12")).result(SECONDS_MAX), "there is room again"


def test_a_refusal_is_its_own_drafts_alone(opened, log):
    log.let_through.release(10)
    futures = [opened.submit(draft(body)) for body in (b"1", b"bad", b"2")]
    with pytest.raises(BadParameter, match="it is bad"):
        futures[1].result(SECONDS_MAX)
    assert [futures[place].result(SECONDS_MAX).stale for place in (0, 2)] == [b"1", b"2"]


@pytest.mark.parametrize("fault", [StoreError("the disk fails"), ZeroDivisionError("a fault of ours")])
def test_a_transaction_that_fails_is_told_to_all_in_it(opened, log, fault):
    log.fault = fault
    log.let_through.release(10)
    for future in [opened.submit(draft()), opened.submit(draft())]:
        with pytest.raises(type(fault), match=str(fault)):
            future.result(SECONDS_MAX)
    log.fault = None
    assert opened.submit(draft()).result(SECONDS_MAX), "the thread lives on"


def test_what_was_taken_cannot_be_cancelled(opened, log):
    future = opened.submit(draft())
    assert not future.cancel()
    log.let_through.release()
    assert future.result(SECONDS_MAX)


def test_closing_writes_what_was_taken(log):
    one = Writer(log.append)
    futures = [one.submit(draft(b"%d" % number)) for number in range(5)]
    log.let_through.release(10)
    one.close()
    assert all(future.done() for future in futures)
    with pytest.raises(StoreError, match="closed"):
        one.submit(draft())
    one.close()


def test_a_thread_that_cannot_be_started_takes_no_draft(log, monkeypatch):
    def refuse(_self):
        raise RuntimeError("can't start new thread")

    log.let_through.release(10)
    with closing(Writer(log.append)) as one:
        monkeypatch.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RuntimeError, match="new thread"):
            one.submit(draft(b"refused"))
        monkeypatch.undo()
        assert one.submit(draft(b"taken")).result(SECONDS_MAX)
    assert log.batches == [[b"taken"]]


def test_one_that_nobody_used_has_no_thread(log):
    before = threading.active_count()
    with closing(Writer(log.append)):
        assert threading.active_count() == before
