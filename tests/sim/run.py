"""One run of a world: everything that happens in it follows from its seed."""

import random
from collections.abc import Callable
from typing import NamedTuple

import pytest

from chunkserver.stream import Stream, connection, outbox, reader, recent, stream
from tests.sim.clock import Clock
from tests.sim.log import Log
from tests.sim.player import Player
from tests.sim.server import Server
from tests.sim.terrain import CHUNKS

PLAYERS_MAX = 3
SECONDS = 1.2
SETTLE_SECONDS = 40.0

SMALL = (
    (outbox, "QUEUE_BYTES_MAX", 400),
    (recent, "RECENT_EDITS_MAX", 8),
    (stream, "REPLAYED_AT_ONCE_MAX", 4),
    (reader, "BEHIND_SECONDS", 0.2),
    (connection, "INFLIGHT_MAX", 4),
)
"""Limits that a short run gets beyond."""


class Run(NamedTuple):
    """What has happened. logs: of each epoch, as it is in the end. epoch: the last. seconds: how long it took."""

    seed: int
    logs: dict[str, Log]
    players: list[Player]
    is_settled: bool
    epoch: str
    seconds: float


def play(seed: int, new_stream: Callable[..., Stream] = Stream) -> Run:
    """Have players dig in a world for some seconds in which everything breaks; then in peace, until all is told."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in SMALL:
            patch.setattr(module, name, value)
        return _play(seed, new_stream)


def _play(seed: int, new_stream: Callable[..., Stream]) -> Run:
    clock, rng = Clock(), random.Random(seed)
    server = Server(clock, rng, new_stream)
    players = [Player(f"player-{number}", clock, rng, server) for number in range(rng.randint(1, PLAYERS_MAX))]
    weights = {turn: rng.choice((0, 1, 2)) for turn in TURNS}
    turns = [turn for turn, weight in weights.items() for _ in range(weight)]
    while clock.now < SECONDS:
        clock.run(clock.now + rng.expovariate(15.0))
        player = rng.choice(players)
        match rng.choice([*turns, *6 * ["dig"]]):
            case "dig":
                player.dig()
            case "burst":
                for _ in range(rng.randint(2, 10)):
                    player.dig()
            case "post":
                for _ in range(rng.randint(1, 6)):
                    server.post([{"op": "dig", "at": rng.randrange(CHUNKS)}])
            case "look":
                player.look()
            case "cut":
                player.cut()
            case "doze":
                player.doze(rng.choice((0.2, 1.0, 7.0)))
            case "compact":
                server.compact()
            case "crash":
                server.crash()
                clock.after(rng.uniform(0.0, 0.5), server.start)
            case "stop":
                server.stop()
                clock.after(rng.uniform(0.0, 0.5), server.start)
            case "replace" if rng.random() < 0.2:
                server.replace()
                clock.after(rng.uniform(0.0, 0.5), server.start)
    end = clock.now + SETTLE_SECONDS
    clock.run(end, lambda: all(player.is_settled() for player in players))
    return Run(seed, server.logs, players, all(player.is_settled() for player in players), server.log.epoch, clock.now)


TURNS = ("burst", "post", "look", "cut", "doze", "compact", "crash", "stop", "replace")
"""What happens beside digging; each run has some of it."""
