"""The books of a crowd: who is owed an edit, who has it, and what is wrong if nothing more comes."""

from typing import Any

import pytest

from chunkserver_loadtest import tellings
from chunkserver_loadtest.tellings import EVERYWHERE, Listener, Look, Sent, Tellings, Verdict

CELLS = 32
NEAR, AWAY = Look((0, 0, 0), (31, 31, 31), 0), Look((64, 0, 0), (95, 31, 31), 0)
HERE = [{"lod": 0, "min": [0, 0, 0], "max": [0, 0, 0]}]
STROKES = [{"op": "carve"}]
FINE = Verdict(0, 0, 0, 0)


class Books:
    """Books of listeners, and what was told to all."""

    def __init__(self, *looks: Look, known: int = 0) -> None:
        self.told: list[Sent] = []
        self.books = Tellings(CELLS, self.told.append)
        self.listeners = [self.books.join(look, known) for look in looks]

    def answer(self, revision: int, stale: list[dict[str, Any]] | None = HERE) -> Sent:
        sent = Sent(0.0, STROKES, answered=1.0, status=200, revision=revision)
        self.books.answer(sent, stale)
        return sent

    def tell(self, listener: Listener, *revisions: int, known: int | None = None) -> None:
        self.books.tell(listener, revisions, max(revisions) if known is None else known, 2.0)


def is_over(books: Books) -> bool:
    """Return whether nobody can be told any more."""
    return books.books.is_over


@pytest.mark.parametrize("answer_first", [True, False])
def test_an_edit_is_settled_when_all_have_it(answer_first: bool):
    books = Books(EVERYWHERE, EVERYWHERE)
    one, other = books.listeners
    if answer_first:
        sent = books.answer(1)
        books.tell(one, 1)
    else:
        books.tell(one, 1)
        sent = books.answer(1)
    assert (books.books.unsettled, books.told, sent.told) == (1, [], 1)
    books.tell(other, 1)
    assert (books.books.unsettled, books.told, sent.told_at) == (0, [sent], 2.0)
    assert books.books.verdict() == FINE


def test_only_who_looks_there_is_owed_an_edit():
    books = Books(NEAR, AWAY)
    near, away = books.listeners
    sent = books.answer(1)
    books.tell(away, 1)
    assert books.books.unsettled == 1, "whoever is told beside the others does not stand for one of them"
    books.tell(near, 1)
    assert (books.books.unsettled, sent.told) == (0, 1)


@pytest.mark.parametrize(
    ("chunk", "lod", "is_there"),
    [
        ([0, 0, 0], 0, True),
        ([1, 0, 0], 0, False),
        ([-1, 0, 0], 0, True),
        ([-2, 0, 0], 0, False),
        ([0, 0, 0], 1, False),
    ],
)
def test_a_chunk_is_in_a_region_with_its_border(chunk: list[int], lod: int, is_there: bool):
    assert NEAR.meets([{"lod": lod, "min": chunk, "max": chunk}], CELLS) is is_there
    wider = Look(NEAR.low, (32, 31, 31), 0)
    assert wider.meets([{"lod": 0, "min": [1, 0, 0], "max": [2, 0, 0]}], CELLS)


def test_an_edit_that_changes_nothing_or_nobody_knows_what_is_owed_to_nobody():
    books = Books(EVERYWHERE)
    books.answer(1, [])
    books.answer(2, None)
    assert (books.books.unsettled, books.told) == (0, [])


def test_who_knows_of_later_edits_has_missed_one_and_who_does_not_is_late():
    books = Books(EVERYWHERE, EVERYWHERE, EVERYWHERE)
    books.answer(1)
    books.answer(2)
    books.tell(books.listeners[0], 1, 2)
    books.tell(books.listeners[1], 2)
    assert is_over(books) is False
    assert books.books.verdict() == Verdict(1, 2, 0, 0)
    books.tell(books.listeners[2], known=2)
    assert is_over(books) is True
    assert books.books.verdict() == Verdict(3, 0, 0, 0)


def test_who_is_left_out_or_lost_is_owed_nothing_there():
    books = Books(EVERYWHERE, EVERYWHERE, EVERYWHERE)
    stale, lost, other = books.listeners
    books.answer(1)
    books.tell(lost, 1)
    books.books.lose(lost)
    books.books.leave_out(stale, 2)
    books.answer(2)
    for revision in (1, 2):
        books.tell(other, revision)
    assert (books.books.unsettled, [sent.told for sent in books.told]) == (0, [2, 1])
    books.answer(3)
    books.tell(other, 3)
    assert books.books.verdict() == Verdict(0, 1, 0, 0), "what comes later is owed again"
    books.tell(stale, 3)
    assert books.books.is_over
    assert books.books.verdict() == FINE


def test_who_comes_later_is_not_owed_what_was_before():
    books = Books(EVERYWHERE)
    sent = books.answer(1)
    late = books.books.join(EVERYWHERE, 2)
    books.answer(2)
    books.tell(late, 3)
    books.tell(books.listeners[0], 1, 2)
    books.answer(3)
    assert (books.books.unsettled, sent.told) == (1, 1)
    books.tell(books.listeners[0], 3)
    assert books.books.verdict() == FINE


def test_who_comes_later_does_not_stand_for_somebody_else():
    books = Books(EVERYWHERE)
    sent = books.answer(1)
    late = books.books.join(EVERYWHERE, 0)
    books.tell(late, 1)
    assert (books.books.unsettled, sent.told) == (1, 0)
    books.tell(books.listeners[0], 1)
    books.tell(late, 1)
    assert (books.books.unsettled, books.books.verdict()) == (0, FINE)


def test_an_edit_that_nobody_was_answered_for_is_strange():
    books = Books(EVERYWHERE)
    books.tell(books.listeners[0], 1, 2)
    books.answer(2)
    assert books.books.verdict() == Verdict(0, 0, 1, 0)


@pytest.mark.parametrize("answer_first", [True, False])
@pytest.mark.parametrize("content", [STROKES, [{"op": "fill"}]])
def test_an_edit_has_to_be_what_was_sent(answer_first: bool, content: list[dict[str, Any]]):
    books = Books(EVERYWHERE)
    if answer_first:
        books.answer(1)
    books.books.content(1, content)
    books.tell(books.listeners[0], 1)
    if not answer_first:
        books.answer(1)
    assert books.books.verdict() == Verdict(0, 0, 0, int(content != STROKES))


def test_books_are_bounded(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tellings, "OPEN_MAX", 3)
    monkeypatch.setattr(tellings, "SETTLED_MAX", 3)
    monkeypatch.setattr(tellings, "SPANS_MAX", 3)
    books = Books(EVERYWHERE)
    for revision in range(1, 11):
        books.answer(revision)
    assert books.books.unsettled == 3
    assert books.books.verdict() == Verdict(0, 10, 0, 0)
    for revision in range(1, 11):
        books.books.leave_out(books.listeners[0], revision)
    assert books.books.unsettled == 0
    assert len(books.listeners[0].left_out) == 3
    for revision in range(11, 21):
        books.answer(revision, [])
    assert all(len(kept) <= 3 for kept in vars(books.books).values() if isinstance(kept, dict | list | set))
