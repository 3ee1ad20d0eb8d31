"""Load on a server, in a closed or an open loop: the generator is the load-test kit's, the figures are the benchmarks'.

Content is not looked at, so that the client takes little of the cores that it shares with the server.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Coroutine, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from chunkserver_loadtest import exchange
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.exchange import Exchange
from chunkserver_loadtest.generator import Limits, Observer, saturate
from chunkserver_loadtest.generator import offer as offer_load
from chunkserver_loadtest.target import resolve

LOAD_SECONDS_MAX: Final = 300.0
OPEN_CONNECTIONS_MAX: Final = 800
"""Of an open loop; a server takes 4,096 unless told otherwise."""
GOOD: Final = frozenset(("200", "204", "304"))


class Request(NamedTuple):
    """What to ask for, and the etag to send as `If-None-Match`, if any; a POST of JSON, if there is a body."""

    path: str
    etag: str = ""
    body: bytes = b""


@dataclass(slots=True)
class Load(Observer):
    """What a load came to.

    seconds: from the first request to the last answer. cpu_seconds: of this process, meanwhile.
    bytes: of all answers, heads included.
    latencies: seconds, one per answer, ascending. good_latencies: of the answers that are no errors, as they came.
    statuses: how many answers had each status, and how many requests have none, by what came instead.
    """

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    bytes: int = 0
    latencies: list[float] = field(default_factory=list)
    good_latencies: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    _started: float = 0.0
    _cpu_started: float = 0.0

    @property
    def answers(self) -> int:
        """How many requests were answered."""
        return len(self.latencies)

    def begun(self, started: float) -> None:
        """Start the clocks."""
        self._started, self._cpu_started = started, time.process_time()

    def ended(self, exchange: Exchange) -> None:
        """Count what a request came to."""
        self.seconds = exchange.ended - self._started
        if exchange.answer is None:
            self.statuses[exchange.failure] += 1
        else:
            self.count(exchange.status, exchange.latency, exchange.received)

    def unsent(self, _exchange: Exchange) -> None:
        """Count a request that was not sent."""
        self.statuses["unsent"] += 1

    def count(self, status: str, latency: float, answer_bytes: int) -> None:
        """Count one answer."""
        self.latencies.append(latency)
        self.bytes += answer_bytes
        self.statuses[status] += 1
        if status in GOOD:
            self.good_latencies.append(latency)

    def run(self, loading: Coroutine[None, None, None]) -> "Load":
        """Run a load to its end. Raises TimeoutError if it did not end in time."""
        with asyncio.Runner(loop_factory=new_event_loop) as runner:
            runner.run(self._timed(loading))
        self.latencies.sort()
        if self.statuses["timeout"]:
            raise TimeoutError(f"{self.statuses['timeout']} requests had no answer within {LOAD_SECONDS_MAX:g} s")
        return self

    async def _timed(self, loading: Coroutine[None, None, None]) -> None:
        await loading
        self.cpu_seconds = time.process_time() - self._cpu_started

    def quantile(self, share: float) -> float:
        """Return the latency, in seconds, that `share` of the answers did not exceed."""
        return self.latencies[min(int(share * len(self.latencies)), len(self.latencies) - 1)]


def send(url: str, requests: Sequence[Request], connections: int) -> Load:
    """Send all requests over so many connections, each in turn: a closed loop.

    Raises ConnectionError if a request has no answer, TimeoutError after LOAD_SECONDS_MAX.
    """
    load, limits = Load(), Limits(LOAD_SECONDS_MAX, len(requests), connections, timeout=LOAD_SECONDS_MAX)
    load.run(saturate(resolve(url), map(_asked, requests), limits, load))
    if load.answers < len(requests):
        raise ConnectionError(f"{len(requests)} requests ended as {dict(load.statuses)}")
    return load


def send_for(url: str, requests: Iterable[Request], connections: int, seconds: float) -> Load:
    """Send requests for so long over so many connections, each in turn: a closed loop.

    Raises TimeoutError if answers are missing after LOAD_SECONDS_MAX.
    """
    load, limits = Load(), Limits(seconds, connections=connections, timeout=LOAD_SECONDS_MAX)
    return load.run(saturate(resolve(url), map(_asked, requests), limits, load))


def offer(url: str, requests: Iterable[Request], rate: float, seconds: float) -> Load:
    """Send requests at a fixed rate, whether or not earlier ones are answered: an open loop, as many users are.

    rate: requests a second. seconds: for how long; then the answers that are still to come are waited for.
    Latencies count from when a request was due. One for which OPEN_CONNECTIONS_MAX others wait is not sent, and is
    counted as `unsent`; one whose connection ends before its answer is counted as what happened.

    Raises TimeoutError if answers are missing after LOAD_SECONDS_MAX.
    """
    limits = Limits(seconds, int(rate * seconds), OPEN_CONNECTIONS_MAX, OPEN_CONNECTIONS_MAX, LOAD_SECONDS_MAX)
    load = Load()
    schedule = ((number / rate, _asked(request)) for number, request in enumerate(requests))
    return load.run(offer_load(resolve(url), schedule, limits, load))


def _asked(request: Request) -> exchange.Request:
    return exchange.Request(request.path, etag=request.etag, body=request.body)
