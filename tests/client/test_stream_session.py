"""A session: what it says on each connection, what it makes of what it hears, and when it connects again."""

import pytest

from chunkserver_client.stream import ChunkRange, Ended, Refresh, StartOver
from chunkserver_client.stream.messages import Ack, Edit, Edits, Nack
from chunkserver_client.stream.session import SILENCE_SECONDS
from chunkserver_client.stream.unanswered import EDITS_MAX
from tests.client.stream_game import FAR, NEAR, RANGE, STROKES, Game


def test_the_first_hello_knows_nothing():
    game = Game(welcomed=False)
    assert game.connect_at() == 0.0
    game.session.connected()
    assert game.connect_at() is None
    region = {"min": [0, 0, 0], "max": [31, 31, 31], "lod": 20}
    told = {"client": "me", "epoch": None, "resume": None, "regions": [region]}
    assert game.said() == [{"type": "hello", **told}]


def test_a_later_one_resumes():
    game = Game(revision=10)
    game.edits(10, 12)
    game.session.lost()
    game.session.connected()
    [hello] = game.said()
    assert (hello["epoch"], hello["resume"]) == ("one", "12")


def test_edits_lead_on():
    game = Game(revision=10)
    game.show(NEAR)
    assert game.edits(10, 12) == [Edits(10, 12, (Edit(12, STROKES),), (ChunkRange(0, (0, 0, 0), (0, 0, 0)),))]
    assert game.session.revision == 12
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR}), 12)]


@pytest.mark.parametrize(("after", "revision"), [(9, 12), (11, 12), (10, 9)])
def test_edits_that_do_not_follow_break_the_connection(after: int, revision: int):
    game = Game(revision=10)
    assert game.edits(after, revision) == []
    assert game.is_broken()
    assert game.edits(10, 12) == []
    assert game.session.revision == 10


def test_nothing_leads_back():
    for kind, members in (
        ("progress", {"asked": 0}),
        ("stale", {"chunks": []}),
        ("resync", {"floor": "0", "epoch": "one"}),
    ):
        game = Game(revision=10)
        game.hear(kind, revision="10", **members)
        assert not game.is_broken()
        game.hear(kind, revision="9", **members)
        assert game.is_broken()


def test_stale_and_resync_outdate_chunks():
    game = Game(revision=10)
    game.show(NEAR, FAR)
    game.hear("stale", chunks=[RANGE], revision="20")
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR}), 20)]
    game = Game(revision=10)
    game.show(NEAR, FAR)
    game.hear("resync", floor="15", revision="20", epoch="one")
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR, FAR}), 20)]
    assert game.session.revision == 20


def test_an_edit_is_sent_once_and_answered_once():
    game = Game()
    game.show(NEAR)
    seq = game.session.edit(STROKES)
    assert game.said() == [{"type": "edit", "seq": seq, "strokes": STROKES}]
    assert not game.said()
    [ack] = game.ack(seq, 11)
    assert isinstance(ack, Ack)
    assert game.ack(seq, 11) == []
    assert game.session.unanswered == 0
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR}), 11)]
    assert game.session.revision == 10


def test_a_refusal_is_an_answer():
    game = Game()
    seq = game.session.edit(STROKES)
    problem = {"type": "t", "title": "no", "status": 422, "detail": "no"}
    [nack] = game.hear("nack", seq=seq, problem=problem)
    assert isinstance(nack, Nack)
    assert game.hear("nack", seq=seq, problem=problem) == []
    assert game.session.unanswered == 0


def test_what_is_not_answered_is_sent_again_unchanged():
    game = Game()
    seqs = [game.session.edit([{"op": "carve", "n": n}]) for n in range(3)]
    first = game.said()
    game.ack(seqs[1], 11)
    game.session.lost()
    late = game.session.edit(STROKES)
    assert not game.said()
    game.connect(last_seq=seqs[1])
    said = game.said()
    assert [said[0], said[1]] == [first[0], first[2]]
    assert [message["seq"] for message in said] == [seqs[0], seqs[2], late]


def test_only_so_many_edits_are_under_way():
    game = Game(inflight=2)
    seqs = [game.session.edit(STROKES) for _ in range(4)]
    assert game.seqs() == seqs[:2]
    assert game.seqs() == []
    game.ack(seqs[0], 11)
    assert game.seqs() == seqs[2:3]
    game.session.lost()
    game.connect(inflight=2)
    assert game.seqs() == seqs[1:3]


def test_seqs_rise_above_all_that_was_used():
    game = Game(welcomed=False)
    game.connect(last_seq=41)
    assert game.session.edit(STROKES) == 42
    game.session.lost()
    game.connect(last_seq=None)
    assert game.session.edit(STROKES) == 43


def test_another_epoch_starts_over():
    game = Game(revision=10)
    game.show(NEAR)
    seq = game.session.edit(STROKES)
    game.session.lost()
    events = game.connect(epoch="two", revision=30)
    assert events[0] == StartOver("two", 30, (seq,))
    assert game.session.revision == 30
    assert game.session.chunks.are_current
    assert game.seqs() == []
    game.edits(30, 40)
    assert game.session.chunks.are_current


def test_the_first_welcome_outdates_what_was_fetched_before():
    game = Game(welcomed=False)
    game.show(NEAR, FAR)
    game.connect(revision=10)
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR, FAR}), 10)]


def test_messages_in_the_wrong_order_break_the_connection():
    game = Game()
    game.welcome()
    assert game.is_broken()
    game = Game(welcomed=False)
    game.session.connected()
    game.edits(0, 1)
    assert game.is_broken()
    game.session.received("no JSON")
    assert game.is_broken()


def test_silence_breaks_the_connection():
    game = Game()
    game.now += SILENCE_SECONDS
    game.hear("progress", revision="10", asked=0)
    game.now += SILENCE_SECONDS
    assert not game.is_broken()
    game.now += 0.01
    assert game.is_broken()
    game.session.lost()
    assert not game.is_broken()


def test_pauses_double_until_more_than_a_welcome_comes():
    game = Game()
    pauses = []
    for _ in range(5):
        game.session.lost(1001)
        assert game.session.connect_at is not None
        pauses.append(game.session.connect_at - game.now)
        game.session.connected()
    assert pauses == [1.0, 2.0, 4.0, 8.0, 8.0]
    game.welcome()
    game.session.lost()
    assert game.session.connect_at == 8.0
    game.session.connected()
    game.welcome()
    game.hear("progress", revision="10", asked=0)
    game.session.lost()
    assert game.session.connect_at == 1.0


@pytest.mark.parametrize("code", [1009, 4400, 4401, 4403, 4404, 4409, 4412])
def test_some_ends_are_final(code: int):
    game = Game()
    seq = game.session.edit(STROKES)
    assert game.session.lost(code) == [Ended(code, (seq,))]
    assert game.session.connect_at is None
    with pytest.raises(ValueError, match="ended"):
        game.session.edit(STROKES)


def test_edits_come_after_the_first_welcome():
    game = Game(welcomed=False)
    with pytest.raises(ValueError, match="waiting"):
        game.session.edit(STROKES)


def test_too_many_edits_are_refused():
    game = Game()
    game.session.lost()
    for _ in range(EDITS_MAX):
        game.session.edit(STROKES)
    with pytest.raises(OverflowError, match=str(EDITS_MAX)):
        game.session.edit(STROKES)
    game.connect()
    assert game.seqs()[0] == 1


def test_too_many_bytes_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("chunkserver_client.stream.unanswered.BYTES_MAX", 100)
    game = Game()
    seq = game.session.edit(STROKES)
    with pytest.raises(OverflowError, match="bytes"):
        game.session.edit([{"op": "x" * 60}])
    game.ack(seq, 11)
    assert game.session.edit([{"op": "x" * 40}]) == seq + 1


def test_an_answer_may_come_before_an_edit_is_sent_again():
    game = Game()
    seqs = [game.session.edit(STROKES) for _ in range(2)]
    assert game.seqs() == seqs
    game.session.lost()
    late = game.session.edit(STROKES)
    game.connect(inflight=1)
    assert game.seqs() == seqs[:1]
    game.ack(seqs[1], 12)
    game.ack(seqs[0], 11)
    assert game.seqs() == [late]
