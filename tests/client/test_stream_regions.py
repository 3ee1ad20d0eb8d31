"""Where a session looks: what it asks for, what is in force, and that nothing piles up."""

from collections.abc import Sized

import pytest

from chunkserver_client.stream import Refresh, Region, Session
from chunkserver_client.stream.messages import REGIONS_MAX, Progress
from tests.client.stream_game import AWAY, FAR, HOME, NEAR, Game


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


def in_force(game: Game) -> bool:
    """Return whether the server has obeyed."""
    return game.session.are_regions_in_force


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
    assert not in_force(game)
    game.hear("progress", revision="11", asked=1)
    assert not game.said(), "the second is not in force yet"
    game.hear("progress", revision="12", asked=2)
    assert game.regions() == [AWAY]
    assert asked(game) == [("subscribe", [999])]
    game.hear("progress", revision="12", asked=3)
    assert not game.said()
    assert in_force(game)
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
    assert not in_force(game)
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
