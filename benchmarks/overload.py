"""The real server with two workers, offered more than it can build: what is still answered well, and how late.

Every request is for another chunk of a recipe that takes 10 ms or more a chunk. Capacity is what a closed loop gets:
each of 8 connections sends its next request when it has its answer. Then requests come at a fixed rate, whatever comes
of earlier ones: 3 and 10 times the capacity of the same round. What is too much is refused with a 503.

- Goodput: chunks, a second; beside it how many times the capacity that is.
- Lost: requests that had neither a chunk nor a refusal, or that were not even sent.
- Median and 99 % are of the chunks alone, from when a request was due to its last byte.
- Again normal: the capacity once more, 2 s after the load has ended.
- The client and the refusals take their time from the same cores as the workers.
"""

import itertools
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import httpx2

from benchmarks.load import GOOD, Load, Request, offer, send
from benchmarks.measure import MS, Figure, Line, Scale
from tests.serving import serving

WORKERS: Final = 2
CONNECTIONS: Final = 8
RATES: Final = (3, 10)
"""Times the capacity."""
AFTER_SECONDS: Final = 2.0
CAPACITY_SHARE: Final = 0.6
"""Of the seconds of a round, for measuring the capacity: as many requests as 10 ms each would fill them with."""
OCTAVES: Final = 14
_NOISE: Final = {"op": "fbm3", "frequency": 0.05, "octaves": OCTAVES, "gain": 0.9, "lacunarity": 1.1}
RECIPE: Final = {
    "op": "subtract",
    "a": {"op": "y"},
    "b": {"op": "multiply", "a": {"op": "add", "a": _NOISE, "b": {**_NOISE, "salt": 1}}, "b": 6},
}
"""Ground at y = 0 that costs much and has no more triangles than other ground."""
ROUNDS_MAX: Final = 5
"""Each takes about half a minute."""


class Turn(NamedTuple):
    """One phase of one round."""

    load: Load

    @property
    def goodput(self) -> float:
        """Chunks a second."""
        return sum(self.load.statuses[status] for status in GOOD) / self.load.seconds


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for the capacity and one for each rate."""
    rounds: dict[str, list[Turn]] = {}
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "log", "--workers", str(WORKERS)) as server:
        posted = httpx2.post(f"{server.url}/v1/recipes", json=RECIPE)
        digest = posted.raise_for_status().json()["digest"]
        unasked = (
            Request(f"/v1/seeds/1/chunks/0/{x}/0/{z}?recipe={digest}") for z in itertools.count() for x in range(1000)
        )
        for number in range(min(scale.rounds, ROUNDS_MAX) + 1):
            for name, turn in _round(server.url, unasked, scale.load_seconds):
                if number:
                    rounds.setdefault(name, []).append(turn)
    capacity = rounds["capacity"]
    for name, turns in rounds.items():
        yield Line(name, tuple(_figures(turns, [] if turns is capacity else capacity)))


def _round(url: str, unasked: Iterator[Request], seconds: float) -> Iterator[tuple[str, Turn]]:
    count = max(CONNECTIONS, int(CAPACITY_SHARE * seconds * WORKERS / 0.01))
    closed = partial(send, url, connections=CONNECTIONS)
    capacity = Turn(closed(list(itertools.islice(unasked, count))))
    yield "capacity", capacity
    for times in RATES:
        yield f"offered {times} times that", Turn(offer(url, unasked, times * capacity.goodput, seconds))
        time.sleep(min(AFTER_SECONDS, seconds))
    yield "again normal", Turn(closed(list(itertools.islice(unasked, count))))


def _figures(turns: list[Turn], capacity: list[Turn]) -> Iterator[Figure]:
    goodput = tuple(turn.goodput for turn in turns)
    ratios = (
        tuple(turn.goodput / whole.goodput for turn, whole in zip(turns, capacity, strict=True)) if capacity else ()
    )
    yield Figure("goodput", "1/s", goodput, ratios)
    for name, share in (("median", 0.5), ("99 %", 0.99)):
        yield Figure(name, "ms", tuple(_quantile(turn.load.good_latencies, share) * MS for turn in turns))
    answers = tuple(max(turn.load.answers, 1) for turn in turns)
    refused = tuple(turn.load.statuses["503"] for turn in turns)
    yield Figure("refused", "%", tuple(100 * a / b for a, b in zip(refused, answers, strict=True)))
    lost = tuple(float(sum(turn.load.statuses[s] for s in set(turn.load.statuses) - GOOD - {"503"})) for turn in turns)
    yield Figure("lost", "", lost)


def _quantile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)]
