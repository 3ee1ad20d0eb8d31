"""One run: the world is read, the hot set is primed, the load is offered, answers are checked, a result comes out."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Final, NamedTuple

from chunkserver_loadtest.checks import Checker, Fault
from chunkserver_loadtest.errors import BadOption
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.exchange import Answer, Exchange, Request
from chunkserver_loadtest.generator import Limits, Observer, offer, saturate
from chunkserver_loadtest.machine import facts
from chunkserver_loadtest.profiles import PROFILES, Options
from chunkserver_loadtest.record import Histogram, Record
from chunkserver_loadtest.result import MS, Result, Value, summarise
from chunkserver_loadtest.storms import STORMS, Setting, perform
from chunkserver_loadtest.target import Target, resolve
from chunkserver_loadtest.world import World, describe, own_world, revision

UNCHECKED_MAX: Final = 512
"""Answers that wait to be checked. One more is checked at once, however late that makes the next request."""
PRIMING_SECONDS_MAX: Final = 120.0
NAMES: Final = (*PROFILES, *STORMS)
"""What can be run."""


@dataclass(frozen=True)
class Plan:
    """All that a run depends on. world: path of the descriptor. closed: a closed loop, which has no rate."""

    url: str
    world: str
    profile: str
    options: Options = field(default_factory=Options)
    limits: Limits = field(default_factory=Limits)
    format: str = "mesh"
    closed: bool = False
    check_share: float = 1.0
    allow_remote: bool = False
    api_key: str = ""

    def __post_init__(self) -> None:
        if self.profile not in NAMES:
            raise BadOption(f"no profile is called {self.profile!r}: there are {', '.join(NAMES)}")
        if not 0 <= self.check_share <= 1:
            raise BadOption(f"check_share is {self.check_share}: 0 to 1")

    def shown(self) -> dict[str, Value]:
        """Return what a result says of the options: all but the key."""
        own: dict[str, Value] = {"url": self.url, "world": self.world, "format": self.format, "closed": self.closed}
        told = {**own, "check_share": self.check_share, **asdict(self.options), **asdict(self.limits)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in told.items()}


class Snapshot(NamedTuple):
    """How a run stands: rates since the snapshot before, everything else since the start. Times in ms."""

    seconds: float
    seconds_planned: float
    rate: float
    megabytes_per_second: float
    in_flight: int
    due: int
    answered: int
    unsent: int
    failed: int
    p50: float
    p99: float
    longest: float
    lag_p99: float
    statuses: dict[str, int]
    failures: dict[str, str]


Tell = Callable[[Snapshot], None]


def run(plan: Plan, tell: Tell, every: float = 1.0) -> Result:
    """Run a plan to its end, and return its result. tell: is given a snapshot every so many seconds, and at the end.

    Raises LoadTestError for what is wrong before the load begins. A server that answers wrongly is a result.
    """
    target = resolve(plan.url, plan.allow_remote)
    fields = {"Authorization": f"Bearer {plan.api_key}"} if plan.api_key else {}
    if plan.profile in STORMS:
        return _storm(plan, target, fields, tell, every)
    world = describe(target, plan.world, plan.format, fields)
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        return runner.run(_run(plan, target, world, _lines(fields), tell, every))


def _storm(plan: Plan, target: Target, fields: dict[str, str], tell: Tell, every: float) -> Result:
    with own_world(target, plan.world, fields) as (path, is_own), asyncio.Runner(loop_factory=new_event_loop) as runner:
        world = describe(target, path, plan.format, fields)
        asked = partial(revision, target, path, fields)
        setting = Setting(target, world, _lines(fields), plan.options, plan.limits, plan.closed, is_own, asked)
        return runner.run(_run_storm(plan, setting, tell, every))


async def _run_storm(plan: Plan, setting: Setting, tell: Tell, every: float) -> Result:
    record, machine, cpu_started = Record(), facts(), time.process_time()
    telling = asyncio.create_task(_tell(record, plan.limits.seconds, tell, every))
    try:
        found = await perform(STORMS[plan.profile], setting, record)
    finally:
        telling.cancel()
    cpu_seconds = time.process_time() - cpu_started
    tell(Stand(record, plan.limits.seconds).snapshot())
    intended, stream = max(_intended_seconds(plan, record), 1e-9), found.told_of(plan.options)
    token = setting.world.generator
    return summarise(record, plan.profile, plan.shown(), machine, token, intended, cpu_seconds, (0, 0), stream)


async def _run(plan: Plan, target: Target, world: World, fixed: bytes, tell: Tell, every: float) -> Result:
    checker = Checker(world, plan.check_share, plan.options.seed)
    record = CheckedRecord(checker)
    profile, machine = PROFILES[plan.profile], facts()
    primed = await _prime(target, profile.prime(world, plan.options), plan.limits, record, fixed)
    schedule = profile.schedule(world, plan.options, primed)
    telling = asyncio.create_task(_tell(record, plan.limits.seconds, tell, every))
    cpu_started = time.process_time()
    try:
        if plan.closed:
            await saturate(target, (request for _, request in schedule), plan.limits, record, fixed)
        else:
            await offer(target, schedule, plan.limits, record, fixed)
    finally:
        telling.cancel()
    cpu_seconds = time.process_time() - cpu_started
    record.check_all()
    tell(Stand(record, plan.limits.seconds).snapshot())
    checked = checker.decoded, checker.compared
    intended = max(_intended_seconds(plan, record), 1e-9)
    return summarise(record, plan.profile, plan.shown(), machine, world.generator, intended, cpu_seconds, checked)


def _intended_seconds(plan: Plan, record: Record) -> float:
    """Return over how many seconds all that was due was to be sent: fewer than planned if there was no more to send."""
    if plan.closed:
        return min(plan.limits.seconds, record.ended_last - record.started)
    is_paced = plan.profile in STORMS or PROFILES[plan.profile].paced
    return record.due_count / plan.options.rate if is_paced else plan.limits.seconds


class CheckedRecord(Record):
    """A record that looks at answers too: one between two looks at the sockets, so that it delays little."""

    def __init__(self, checker: Checker) -> None:
        super().__init__()
        self._checker = checker
        self._unchecked: deque[Exchange] = deque()
        self._loop = asyncio.get_running_loop()

    def ended(self, exchange: Exchange) -> None:
        """Count an exchange; its answer will be checked soon."""
        super().ended(exchange)
        if exchange.answer is None:
            return
        if not self._unchecked:
            self._loop.call_soon(self._check_next)
        self._unchecked.append(exchange)
        if len(self._unchecked) > UNCHECKED_MAX:
            self.check(self._unchecked.popleft())

    def check(self, exchange: Exchange) -> None:
        """Check an answer now."""
        assert exchange.answer is not None
        try:
            if exchange.request.body:
                for part in self._checker.check_batch(exchange):
                    self.parts[part.status].add(part.arrived - exchange.due)
            else:
                self._checker.check(exchange.request, exchange.answer)
        except Fault as fault:
            self.fail(exchange, fault.kind, fault.detail)

    def check_all(self) -> None:
        """Check what has not been."""
        while self._unchecked:
            self.check(self._unchecked.popleft())

    def _check_next(self) -> None:
        if self._unchecked:
            self.check(self._unchecked.popleft())
        if self._unchecked:
            self._loop.call_soon(self._check_next)


class _Priming(Observer):
    """Keeps the answers without their bodies, and has them checked; faults count as the run's."""

    def __init__(self, record: CheckedRecord) -> None:
        self.answers: list[tuple[Request, Answer]] = []
        self._record = record

    def begun(self, started: float) -> None:
        """Give failures of priming a second to be in."""
        self._record.begun(started)

    def ended(self, exchange: Exchange) -> None:
        """Keep an answer."""
        if exchange.answer is None:
            self._record.fail(exchange, exchange.failure, exchange.detail)
            return
        self._record.check(exchange)
        if exchange.answer.status in (200, 204):
            self.answers.append((exchange.request, exchange.answer._replace(pieces=())))


async def _prime(
    target: Target, requests: Iterable[Request], limits: Limits, record: CheckedRecord, fixed: bytes
) -> list[tuple[Request, Answer]]:
    """Ask for each once, in a closed loop, and return what came; in the order of the paths, whoever was first."""
    priming, asked = _Priming(record), list(requests)
    if asked:
        bounds = Limits(PRIMING_SECONDS_MAX, len(asked), limits.connections, limits.in_flight, limits.timeout)
        await saturate(target, asked, bounds, priming, fixed)
    return sorted(priming.answers, key=lambda pair: (pair[0].path, pair[0].coding))


class Stand:
    """Takes snapshots of a record."""

    def __init__(self, record: Record, seconds_planned: float) -> None:
        self._record = record
        self._planned = seconds_planned
        self._before = (0.0, 0, 0)

    def snapshot(self) -> Snapshot:
        """Return how the run stands now."""
        record, now = self._record, time.perf_counter()
        moment, answered, received = self._before
        since = max(now - max(moment, record.started), 1e-9)
        self._before = (now, record.answered_count, record.bytes)
        everything = Histogram()
        statuses: dict[str, int] = {}
        for (_, status), histogram in record.latency.items():
            everything.merge(histogram)
            statuses[status] = statuses.get(status, 0) + histogram.count
        return Snapshot(
            seconds=now - record.started,
            seconds_planned=self._planned,
            rate=(record.answered_count - answered) / since,
            megabytes_per_second=(record.bytes - received) / since / 1e6,
            in_flight=record.due_count - record.unsent_count - everything.count,
            due=record.due_count,
            answered=record.answered_count,
            unsent=record.unsent_count,
            failed=record.failed_count,
            p50=everything.quantile(0.5) * MS,
            p99=everything.quantile(0.99) * MS,
            longest=everything.highest * MS,
            lag_p99=record.lag.quantile(0.99) * MS,
            statuses=statuses,
            failures={kind: f"{one.count} x {one.path}: {one.detail}" for kind, one in record.failures.items()},
        )


async def _tell(record: Record, seconds: float, tell: Tell, every: float) -> None:
    stand = Stand(record, seconds)
    while True:
        await asyncio.sleep(every)
        tell(stand.snapshot())


def _lines(fields: dict[str, str]) -> bytes:
    return "".join(f"{name}: {value}\r\n" for name, value in fields.items()).encode()
