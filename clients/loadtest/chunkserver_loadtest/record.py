"""What is written down of a load: bounded in memory, however many answers come.

A histogram keeps how many values fell between two marks. Marks lie closer than 0.2 % of the value, so a percentile is
right to 0.1 %; maximum, minimum, sum and count are exact.
"""

import itertools
import math
from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from chunkserver_loadtest.exchange import Exchange
from chunkserver_loadtest.generator import Observer

MARKS: Final = 1024
"""Between a power of two and half of it: each is 1/1024 to 1/512 of the value from the next."""
DURATION_MIN: Final = 1e-6
DURATION_MAX: Final = 4096.0
"""Values beyond are counted at these ends: a histogram has at most 33 * MARKS / 2 counts."""
OPEN_SECONDS_MAX: Final = 3
"""Of the time series: how many seconds have a histogram at a time. Earlier ones keep three figures."""
EXAMPLE_CHARACTERS_MAX: Final = 300


class Histogram:
    """How often which duration came, in seconds."""

    __slots__ = ("_counts", "count", "highest", "lowest", "total")

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self.count = 0
        self.total = 0.0
        self.lowest = math.inf
        self.highest = 0.0

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self.count += 1
        self.total += seconds
        self.highest = max(self.highest, seconds)
        self.lowest = min(self.lowest, seconds)
        mantissa, exponent = math.frexp(min(max(seconds, DURATION_MIN), DURATION_MAX))
        mark = exponent * MARKS + int(mantissa * MARKS)
        self._counts[mark] = self._counts.get(mark, 0) + 1

    def merge(self, other: "Histogram") -> None:
        """Count all that `other` has counted."""
        self.count += other.count
        self.total += other.total
        self.lowest = min(self.lowest, other.lowest)
        self.highest = max(self.highest, other.highest)
        for mark, count in other._counts.items():
            self._counts[mark] = self._counts.get(mark, 0) + count

    def quantile(self, share: float) -> float:
        """Return the smallest duration that at least `share` of all did not exceed; 0 if there is none."""
        wanted = max(1, math.ceil(share * self.count - 1e-9))
        if wanted >= self.count:
            return self.highest
        marks = sorted(self._counts)
        reached = itertools.accumulate(self._counts[mark] for mark in marks)
        mark = next(mark for mark, so_many in zip(marks, reached, strict=True) if so_many >= wanted)
        exponent, place = divmod(mark, MARKS)
        return min(max(math.ldexp((place + 0.5) / MARKS, exponent), self.lowest), self.highest)


@dataclass(slots=True)
class Second:
    """What happened in one second of the run; answers count where they ended.

    latency: until the second is closed; then `p50`, `p99` and `longest`, in seconds, stay.
    """

    due: int = 0
    answered: int = 0
    failed: int = 0
    unsent: int = 0
    bytes: int = 0
    in_flight: int = 0
    p50: float = 0.0
    p99: float = 0.0
    longest: float = 0.0
    latency: Histogram = field(default_factory=Histogram)

    def close(self) -> None:
        """Keep three figures of the latencies."""
        latency, self.latency = self.latency, Histogram()
        self.p50, self.p99, self.longest = latency.quantile(0.5), latency.quantile(0.99), latency.highest


@dataclass(slots=True)
class Failures:
    """Of one kind: how many, and the first."""

    count: int
    path: str
    detail: str


class Record(Observer):
    """Everything about a load that a result is made of.

    latency, service: by kind and status. A failure has what came instead as its status, and the time until then.
    parts: latency of the chunks of batches, by status. seconds: by number, from the start.
    """

    def __init__(self) -> None:
        self.started = 0.0
        self.due_count = 0
        self.unsent_count = 0
        self.answered_count = 0
        self.bytes = 0
        self.in_flight_most = 0
        self.latency: dict[tuple[str, str], Histogram] = defaultdict(Histogram)
        self.service: dict[tuple[str, str], Histogram] = defaultdict(Histogram)
        self.parts: dict[str, Histogram] = defaultdict(Histogram)
        self.lag = Histogram()
        self.ended_last = 0.0
        self.seconds: dict[int, Second] = {}
        self.failures: dict[str, Failures] = {}
        self._open: deque[Second] = deque()

    def begun(self, started: float) -> None:
        """Start the clock."""
        self.started = self.ended_last = started

    def due(self, exchange: Exchange, waits: bool, in_flight: int) -> None:
        """Count a request that is due; if it was sent at once, how late the generator was."""
        self.due_count += 1
        if not waits:
            self.lag.add(exchange.sent - exchange.due)
        self.in_flight_most = max(self.in_flight_most, in_flight)
        second = self._second(exchange.due)
        second.due += 1
        second.in_flight = max(second.in_flight, in_flight)

    def unsent(self, exchange: Exchange) -> None:
        """Count a request that was not sent."""
        self.unsent_count += 1
        self._second(exchange.due).unsent += 1

    def ended(self, exchange: Exchange) -> None:
        """Count an exchange, in its second."""
        place = exchange.request.kind, exchange.status
        self.latency[place].add(exchange.latency)
        self.service[place].add(exchange.service)
        self.bytes += exchange.received
        self.ended_last = exchange.ended
        second = self._second(exchange.ended)
        second.bytes += exchange.received
        second.latency.add(exchange.latency)
        if exchange.answer:
            self.answered_count += 1
            second.answered += 1
        else:
            self.fail(exchange, exchange.failure, exchange.detail)

    def fail(self, exchange: Exchange, kind: str, detail: str, count: int = 1) -> None:
        """Count a failure, or several; the first of its kind is kept as the example."""
        self._second(exchange.ended).failed += count
        path, detail = exchange.request.path[:EXAMPLE_CHARACTERS_MAX], detail[:EXAMPLE_CHARACTERS_MAX]
        self.failures.setdefault(kind, Failures(0, path, detail)).count += count

    @property
    def failed_count(self) -> int:
        """How many failures there were, of all kinds."""
        return sum(failures.count for failures in self.failures.values())

    def totals(self, histograms: Mapping[tuple[str, str], Histogram], place: int) -> dict[str, Histogram]:
        """Return `latency` or `service` added up by kind (place 0) or by status (place 1)."""
        added: dict[str, Histogram] = defaultdict(Histogram)
        for names, histogram in histograms.items():
            added[names[place]].merge(histogram)
        return dict(added)

    def _second(self, moment: float) -> Second:
        number = max(0, int(moment - self.started))
        second = self.seconds.get(number)
        if second is None:
            second = self.seconds[number] = Second()
            self._open.append(second)
            if len(self._open) > OPEN_SECONDS_MAX:
                self._open.popleft().close()
        return second

    def close(self) -> None:
        """Close the seconds that are still open: all is over."""
        while self._open:
            self._open.popleft().close()
