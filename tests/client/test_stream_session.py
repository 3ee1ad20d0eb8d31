"""A session: what it says on each connection, what it makes of what it hears, and when it connects again."""

import json
from collections.abc import Sized
from typing import Any

import pytest

from chunkserver_client import ChunkKey, Retry
from chunkserver_client.stream import ChunkRange, Ended, Refresh, Region, Session, StartOver
from chunkserver_client.stream.messages import REGIONS_MAX, Ack, Edit, Edits, Nack, Progress
from chunkserver_client.stream.session import SILENCE_SECONDS
from chunkserver_client.stream.unanswered import EDITS_MAX

HOME, AWAY = Region((0, 0, 0), (31, 31, 31)), Region((64, 0, 0), (95, 31, 31))
NEAR, FAR = ChunkKey(0, 0, 0, 0), ChunkKey(0, 2, 0, 0)
STROKES = [{"op": "carve"}]
RANGE = {"lod": 0, "min": [0, 0, 0], "max": [0, 0, 0]}


class Game:
    """A session with its clock, and a server that says what a test wants."""

    def __init__(self, *, revision: int = 10, inflight: int = 64, welcomed: bool = True) -> None:
        self.now = 0.0
        retry = Retry(backoff_seconds=1.0, backoff_seconds_max=8.0)
        self.session = Session("me", [HOME], 32, lambda: self.now, retry, lambda _, high: high)
        if welcomed:
            self.connect(revision=revision, inflight=inflight)

    def connect(self, **members: Any) -> list[Any]:
        self.session.connected()
        self.said()
        return self.welcome(**members)

    def welcome(
        self, epoch: str = "one", revision: int = 10, last_seq: int | None = None, inflight: int = 64
    ) -> list[Any]:
        limits = {"frame_bytes": 65536, "inflight": inflight, "regions": 64}
        return self.hear("welcome", epoch=epoch, revision=str(revision), floor="0", last_seq=last_seq, limits=limits)

    def hear(self, kind: str, **members: Any) -> list[Any]:
        return list(self.session.received(json.dumps({"type": kind, **members})))

    def ack(self, seq: int, revision: int) -> list[Any]:
        return self.hear("ack", seq=seq, revision=str(revision), duplicate=False, stale=[RANGE])

    def edits(self, after: int, revision: int) -> list[Any]:
        some = [{"revision": str(revision), "strokes": STROKES}]
        return self.hear("edits", after=str(after), revision=str(revision), edits=some, stale=[RANGE])

    def said(self) -> list[dict[str, Any]]:
        return [json.loads(frame) for frame in self.session.outgoing()]

    def seqs(self) -> list[int]:
        return [message["seq"] for message in self.said() if message["type"] == "edit"]

    def is_broken(self) -> bool:
        return self.session.is_broken

    def connect_at(self) -> float | None:
        return self.session.connect_at

    def regions(self) -> list[Region]:
        return list(self.session.regions)

    def show(self, *keys: ChunkKey) -> None:
        for key in keys:
            self.session.chunks.add(key)
        for refresh in self.session.chunks.take():
            self.session.chunks.done(refresh, self.session.revision)


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


def test_new_regions_are_looked_at_when_they_are_in_force():
    game = Game(revision=10)
    game.show(NEAR, FAR)
    game.session.subscribe(AWAY)
    assert [message["type"] for message in game.said()] == ["subscribe"]
    game.hear("progress", revision="11", asked=0)
    assert game.regions() == [HOME]
    assert game.session.chunks.are_current
    assert game.hear("progress", revision="12", asked=1) == [Progress(12, 1)]
    assert game.hear("progress", revision="12", asked=1) == [], "nothing new is no event"
    assert game.hear("progress", revision="13", asked=1) == [Progress(13, 1)]
    assert game.regions() == [HOME, AWAY]
    assert game.session.chunks.take() == [Refresh(frozenset({FAR}), 12)]


def test_regions_that_were_not_in_force_are_in_the_next_hello():
    game = Game(revision=10)
    game.show(NEAR, FAR)
    game.session.subscribe(AWAY)
    game.session.unsubscribe(HOME)
    game.said()
    game.hear("progress", revision="12", asked=0)
    game.session.lost()
    game.session.connected()
    [hello] = game.said()
    assert [region["min"] for region in hello["regions"]] == [[64, 0, 0]]
    game.welcome()
    assert game.said() == []
    assert game.session.regions == (AWAY,)
    assert game.session.chunks.take() == [Refresh(frozenset({FAR}), 12)]


def test_regions_that_are_asked_for_too_early_wait_for_the_welcome():
    game = Game(welcomed=False)
    game.session.connected()
    game.said()
    game.session.subscribe(AWAY)
    assert game.said() == []
    game.welcome()
    assert [message["type"] for message in game.said()] == ["subscribe"]


def looks(game: Game, count: int) -> None:
    """Look at one place after another, as a player who walks."""
    for x in range(count):
        game.session.subscribe(Region((x, 0, 0), (x, 0, 0)))
        game.session.unsubscribe(Region((x - 1, 0, 0), (x - 1, 0, 0)))


def longest(game: Game) -> int:
    """Return how many things a session keeps of a kind, at most."""
    return max(len(kept) for kept in vars(game.session).values() if isinstance(kept, Sized))


def asked(game: Game) -> list[tuple[str, list[int]]]:
    """Return what is asked for now: the kind, and where its regions begin."""
    return [(message["type"], [region["min"][0] for region in message["regions"]]) for message in game.said()]


def test_looking_elsewhere_without_a_connection_leaves_nothing_to_be_sent():
    game = Game()
    game.session.lost()
    looks(game, 1000)
    assert longest(game) < 10
    assert not game.said()
    game.session.connected()
    [hello] = game.said()
    assert [region["min"][0] for region in hello["regions"]] == [0, 999]
    looks(game, 1000)
    assert longest(game) < 10
    game.welcome()
    assert not game.said(), "what changed and changed back is no news"


def test_two_requests_for_regions_are_under_way_at_most():
    game = Game(revision=10)
    game.session.subscribe(AWAY)
    game.session.unsubscribe(HOME)
    assert asked(game) == [("unsubscribe", [0]), ("subscribe", [64])]
    looks(game, 1000)
    assert not game.said()
    assert longest(game) < 10
    assert not game.session.are_regions_in_force
    game.hear("progress", revision="11", asked=1)
    assert not game.said(), "the second is not in force yet"
    game.hear("progress", revision="12", asked=2)
    assert game.regions() == [AWAY]
    assert asked(game) == [("subscribe", [999])]
    game.hear("progress", revision="12", asked=3)
    assert not game.said()
    assert game.session.are_regions_in_force
    assert [region.low[0] for region in game.session.regions] == [64, 999]


def test_a_region_that_the_server_was_told_to_forget_is_new_again():
    game = Game(revision=10)
    game.show(NEAR)
    game.session.unsubscribe(HOME)
    game.said()
    game.session.subscribe(HOME)
    assert game.regions() == [], "edits may be missed from now on"
    game.hear("progress", revision="11", asked=1)
    assert asked(game) == [("subscribe", [0])]
    assert game.session.chunks.are_current
    game.hear("progress", revision="12", asked=2)
    assert game.session.chunks.take() == [Refresh(frozenset({NEAR}), 12)]


def test_a_region_that_was_never_forgotten_is_not():
    game = Game(revision=10)
    game.show(NEAR)
    game.session.lost()
    game.session.unsubscribe(HOME)
    game.session.subscribe(HOME)
    game.connect(revision=11)
    assert game.regions() == [HOME]
    assert game.session.chunks.are_current, "it goes on from where it was"


def test_a_region_that_was_not_in_a_hello_is_new():
    game = Game(revision=10)
    game.session.lost()
    game.session.unsubscribe(HOME)
    game.connect()
    game.session.subscribe(HOME)
    assert not game.session.are_regions_in_force
    assert game.regions() == []
    assert asked(game) == [("subscribe", [0])]


def test_too_many_regions_are_refused_and_change_nothing():
    game = Game()
    many = [Region((x, 0, 0), (x, 0, 0)) for x in range(REGIONS_MAX)]
    with pytest.raises(ValueError, match=f"{REGIONS_MAX + 1} regions: a session looks at {REGIONS_MAX} at most"):
        game.session.subscribe(*many)
    with pytest.raises(ValueError, match="low is nowhere above high"):
        game.session.subscribe(AWAY, Region((1, 0, 0), (0, 0, 0)))
    assert not game.said()
    game.session.subscribe(*many[1:])
    game.session.unsubscribe(HOME, *many[1:])
    game.session.subscribe(*many)
    assert asked(game) == [("unsubscribe", [0]), ("subscribe", list(range(REGIONS_MAX)))], "room is made first"
    with pytest.raises(ValueError, match="regions"):
        Session("me", [HOME, *many], 32, lambda: 0.0)


def test_more_obedience_than_requests_breaks_the_connection():
    game = Game(revision=10)
    game.hear("progress", revision="10", asked=1)
    assert game.is_broken()


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


def test_pauses_double_until_a_welcome():
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


def test_regions_that_nobody_wants_any_more_are_no_news():
    game = Game(revision=10)
    game.show(NEAR, FAR)
    game.hear("progress", revision="12", asked=0)
    game.session.lost()
    game.session.subscribe(AWAY)
    game.session.unsubscribe(AWAY)
    game.connect()
    assert game.regions() == [HOME]
    assert game.session.chunks.are_current
