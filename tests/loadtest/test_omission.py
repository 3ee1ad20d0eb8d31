"""Percentiles are right where a closed loop's are not: a server that stalls for a second in the middle.

Requests are due evenly for T seconds, and the server is silent for S of them. A request that is due within the stall
waits for its end: S - t seconds if it is due t seconds after the beginning. So a share S / T of the requests has
latencies that are evenly spread over 0 to S, and the share above L is (S - L) / T: the quantile q is S - (1 - q) * T.
"""

import asyncio
import itertools
import time

import pytest

from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.exchange import Request
from chunkserver_loadtest.generator import Limits, offer, saturate
from chunkserver_loadtest.record import Histogram, Record
from chunkserver_loadtest.target import resolve
from tests.loadtest.stub import OK, answering

SECONDS = 4.0
STALL = 1.0
STALLS_AFTER = 1.5
RATE = 100.0
TOLERANCE = 0.08
"""Seconds: a busy machine's."""


class Stalling:
    """Answers at once, but for a second in which nobody gets an answer."""

    def __init__(self) -> None:
        self.started = 0.0

    async def __call__(self, _head: str) -> bytes:
        now = time.perf_counter()
        self.started = self.started or now
        into = now - self.started - STALLS_AFTER
        if 0 <= into < STALL:
            await asyncio.sleep(STALL - into)
        return OK


@pytest.fixture(scope="module")
def records() -> dict[str, Record]:
    """Return what an open and a closed loop measured of such a server, side by side."""
    found = {}
    for loop in ("open", "closed"):
        found[loop] = record = Record()
        limits = Limits(seconds=SECONDS, connections=4)
        with answering(Stalling()) as server, asyncio.Runner(loop_factory=new_event_loop) as runner:
            target = resolve(server.url)
            if loop == "open":
                schedule = ((number / RATE, Request("/")) for number in itertools.count())
                runner.run(offer(target, schedule, limits, record))
            else:
                runner.run(saturate(target, itertools.repeat(Request("/")), limits, record))
    return found


def latency(record: Record) -> Histogram:
    return record.latency["chunk", "200"]


@pytest.mark.parametrize("share", [0.8, 0.9, 0.95, 0.99])
def test_an_open_loop_sees_a_stall_as_all_users_do(records, share):
    expected = STALL - (1 - share) * SECONDS
    assert latency(records["open"]).quantile(share) == pytest.approx(expected, abs=TOLERANCE)


def test_an_open_loop_asks_all_who_would_have_come(records):
    assert latency(records["open"]).count == SECONDS * RATE
    assert latency(records["open"]).quantile(0.5) < TOLERANCE


def test_service_time_of_the_same_run_misses_it(records):
    """Only as many as there are connections were sent before the stall and answered after it."""
    service = records["open"].service["chunk", "200"]
    assert service.quantile(0.95) < TOLERANCE
    assert service.highest == pytest.approx(STALL, abs=TOLERANCE)


def test_a_closed_loop_beside_it_misses_it(records):
    closed = latency(records["closed"])
    assert closed.highest == pytest.approx(STALL, abs=TOLERANCE)
    assert closed.count > 1000
    assert closed.quantile(0.99) < TOLERANCE < STALL - 0.01 * SECONDS - TOLERANCE


def test_the_seconds_show_when_it_was(records):
    record = records["open"]
    record.close()
    answered = [record.seconds[number].answered for number in range(4)]
    assert answered[0] == pytest.approx(RATE, abs=10)
    assert answered[1] == pytest.approx(RATE / 2, abs=10)
    assert answered[2] == pytest.approx(1.5 * RATE, abs=10)
    assert record.seconds[2].longest == pytest.approx(STALL, abs=TOLERANCE)
