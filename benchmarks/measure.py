"""How anything is measured here: candidates in turns, a value per round, medians and quartiles of the rounds.

    round 0    a b c      not counted: compiles, opens connections, fills caches
    round 1    b c a
    round 2    c a b      each round begins with another candidate

Clocks drift and neighbours come and go, by far more than what we want to see. Candidates that take turns suffer alike,
so the ratio of two of them within a round is steadier than either.
"""

import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar

MS: Final = 1e3
US: Final = 1e6
NS: Final = 1e9

_Item = TypeVar("_Item")
_Name = TypeVar("_Name")
_Result = TypeVar("_Result")


class Scale(NamedTuple):
    """How much to run.

    chunks: different chunks in rotation; repeating one flatters everybody.
    rounds: of candidates in turns.
    cold_requests, warm_requests: that a round sends to the server; each cold one is another chunk.
    load_seconds: how long a round offers load at a fixed rate.
    starts: rounds of starting a process.
    compiles: starts without compiled code.
    log_strokes: in the log of a world that a server is started with.
    """

    chunks: int
    rounds: int
    cold_requests: int
    warm_requests: int
    load_seconds: float
    starts: int
    compiles: int
    log_strokes: int


FULL: Final = Scale(
    chunks=64,
    rounds=15,
    cold_requests=512,
    warm_requests=2048,
    load_seconds=5.0,
    starts=5,
    compiles=3,
    log_strokes=100_000,
)
TINY: Final = Scale(
    chunks=2,
    rounds=2,
    cold_requests=8,
    warm_requests=16,
    load_seconds=0.3,
    starts=1,
    compiles=0,
    log_strokes=400,
)

assert FULL.chunks >= 64, "fewer chunks stay in the caches between two turns"


class Spread(NamedTuple):
    """Median and quartiles."""

    median: float
    low: float
    high: float


def spread(values: Sequence[float]) -> Spread:
    """Return the median and the quartiles of `values`, which is not empty."""
    if len(values) == 1:
        return Spread(values[0], values[0], values[0])
    low, median, high = statistics.quantiles(values, n=4, method="inclusive")
    return Spread(median, low, high)


@dataclass(frozen=True, slots=True)
class Figure:
    """What one candidate, or one stage, came to.

    rounds: a value for each round, in `unit`; one value for what does not vary.
    ratios: how many times ours it is, round by round; empty if nothing is compared.
    """

    name: str
    unit: str
    rounds: tuple[float, ...]
    ratios: tuple[float, ...] = ()


class Line(NamedTuple):
    """The figures of one subject: a line of a job's table."""

    subject: str
    figures: tuple[Figure, ...]


def in_turns(
    candidates: Mapping[_Name, Callable[[], _Result]], rounds: int, uncounted: int = 1
) -> dict[_Name, list[_Result]]:
    """Return what each candidate returned in each of `rounds` rounds, after those that are not counted."""
    names = list(candidates)
    results: dict[_Name, list[_Result]] = {name: [] for name in names}
    for turn in range(uncounted + rounds):
        first = turn % len(names)
        for name in names[first:] + names[:first]:
            result = candidates[name]()
            if turn >= uncounted:
                results[name].append(result)
    return results


def timed(action: Callable[[_Item], object], items: Iterable[_Item], per_second: float) -> Callable[[], float]:
    """Return a candidate: how long `action` took per item, all items one after the other, in 1/`per_second` s."""
    rotation = tuple(items)

    def turn() -> float:
        started = time.perf_counter()
        for item in rotation:
            action(item)
        return (time.perf_counter() - started) / len(rotation) * per_second

    return turn


def figures(rounds: Mapping[str, Sequence[float]], unit: str) -> tuple[Figure, ...]:
    """Return a figure for each candidate, by itself."""
    return tuple(Figure(name, unit, tuple(values)) for name, values in rounds.items())


def beside_first(rounds: Mapping[str, Sequence[float]], unit: str) -> tuple[Figure, ...]:
    """Return a figure for each candidate; all but the first, which is ours, with their ratios to it."""
    ours, *peers = rounds
    return (
        Figure(ours, unit, tuple(rounds[ours])),
        *(
            Figure(
                peer, unit, tuple(rounds[peer]), tuple(a / b for a, b in zip(rounds[peer], rounds[ours], strict=True))
            )
            for peer in peers
        ),
    )
