"""What this generator can do on this machine: its own ceiling, against a server that answers at once."""

import asyncio
import itertools
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.exchange import Request
from chunkserver_loadtest.generator import Limits, offer, saturate
from chunkserver_loadtest.record import Histogram, Record
from chunkserver_loadtest.result import MS
from chunkserver_loadtest.target import Target, resolve

SHARE: Final = 0.5
"""Of the ceiling: the rate at which latency and lag are looked at."""
PATH: Final = "/v1/seeds/42/chunks/0/-123/-1/456.mesh?recipe=terrain"
START_SECONDS_MAX: Final = 30.0


class Ceiling(NamedTuple):
    """Of a closed loop: requests a second, and CPU us of each. Of an open loop at half that rate: ms."""

    requests_per_second: float
    cpu_us: float
    rate: float
    latency_p50: float
    latency_p99: float
    lag_p50: float
    lag_p99: float


@contextmanager
def instant_server(body_bytes: int) -> Iterator[str]:
    """Yield the URL of a server, in a process of its own, that answers at once."""
    command = [sys.executable, "-m", "chunkserver_loadtest.instant", str(body_bytes)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdin
        assert child.stdout
        try:
            yield f"http://127.0.0.1:{int(child.stdout.readline())}"
        finally:
            child.stdin.close()
            child.wait(START_SECONDS_MAX)


def measure(seconds: float, connections: int, body_bytes: int) -> Ceiling:
    """Return the ceiling of one process here; the server takes its share of the same machine."""
    limits = Limits(seconds=seconds, connections=connections)
    with instant_server(body_bytes) as url, asyncio.Runner(loop_factory=new_event_loop) as runner:
        target = resolve(url)
        closed, cpu_us = runner.run(_closed(target, limits))
        rate = max(1.0, SHARE * closed)
        record = runner.run(_open(target, limits, rate))
    latency = Histogram()
    for histogram in record.latency.values():
        latency.merge(histogram)
    times = (one.quantile(share) * MS for one in (latency, record.lag) for share in (0.5, 0.99))
    return Ceiling(closed, cpu_us, rate, *times)


async def _closed(target: Target, limits: Limits) -> tuple[float, float]:
    record, cpu_started = Record(), time.process_time()
    await saturate(target, itertools.repeat(Request(PATH)), limits, record)
    cpu_seconds = time.process_time() - cpu_started
    answered = max(record.answered_count, 1)
    return answered / max(record.ended_last - record.started, 1e-9), cpu_seconds / answered * 1e6


async def _open(target: Target, limits: Limits, rate: float) -> Record:
    record = Record()
    await offer(target, ((number / rate, Request(PATH)) for number in itertools.count()), limits, record)
    return record
