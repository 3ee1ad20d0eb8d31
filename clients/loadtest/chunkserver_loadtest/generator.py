"""Sends requests and reads answers: in an open loop, as many users are, or in a closed one, as a measure of capacity.

**Open**: each request has a moment at which it is due, whatever became of those before it. Its latency counts from
then. If all connections are busy it waits, and its waiting counts. So a server that stalls is seen by all who
would have come meanwhile, not only by those few that were being answered.

**Closed**: each connection sends its next request when it has its answer. A server that stalls is asked less: what a
closed loop says about latency is true only for as many users as it has connections.
"""

import asyncio
import gc
import itertools
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from chunkserver_loadtest.alarm import alarm
from chunkserver_loadtest.connection import Connection
from chunkserver_loadtest.errors import BadOption, BadTarget
from chunkserver_loadtest.exchange import Exchange, Request
from chunkserver_loadtest.target import Target

SECONDS_MAX: Final = 86_400.0
REQUESTS_MAX: Final = 100_000_000
CONNECTIONS_MAX: Final = 4_096
IN_FLIGHT_MAX: Final = 1_000_000
TIMEOUT_SECONDS_MAX: Final = 600.0
SWEEP_SECONDS: Final = 0.05
"""How often it is looked for answers that take too long."""
OPENED_MAX: Final = 64
"""Connections of an open loop that are opened before it begins; more are when requests wait."""
BURST_MAX: Final = 256
"""Requests that are sent before the answers that have come are read."""


@dataclass(frozen=True)
class Limits:
    """What bounds a load.

    seconds: for how long requests are sent. requests: how many, at most.
    connections: at most; those of a closed loop are opened before it begins, of an open loop up to OPENED_MAX.
    in_flight: requests that were due and have no answer: one more is not sent, and is counted as unsent.
    timeout: seconds from when a request is sent; as long, at most, the last answers are waited for.

    Raises BadOption if one of them is out of its range.
    """

    seconds: float = 10.0
    requests: int = REQUESTS_MAX
    connections: int = 32
    in_flight: int = 10_000
    timeout: float = 30.0

    def __post_init__(self) -> None:
        for name, most in (("seconds", SECONDS_MAX), ("timeout", TIMEOUT_SECONDS_MAX)):
            if not 0 < getattr(self, name) <= most:
                raise BadOption(f"{name} is {getattr(self, name)}: above 0, at most {most:g}")
        counts = (("requests", REQUESTS_MAX), ("connections", CONNECTIONS_MAX), ("in_flight", IN_FLIGHT_MAX))
        for name, most in counts:
            if not 1 <= getattr(self, name) <= most:
                raise BadOption(f"{name} is {getattr(self, name)}: 1 to {most}")


class Observer:
    """Is told what happens, on the event loop: whatever it does delays the load. This one does nothing."""

    def begun(self, started: float) -> None:
        """Connections are open; the load begins at `started`, of `time.perf_counter`."""

    def due(self, exchange: Exchange, waits: bool, in_flight: int) -> None:
        """A request was due, and has been sent unless it waits for a connection. in_flight: with this one."""

    def unsent(self, exchange: Exchange) -> None:
        """A request was not sent: as many as may be were in flight, or its time ran out while it waited."""

    def ended(self, exchange: Exchange) -> None:
        """An exchange has its answer, or will have none."""


Schedule = Iterable[tuple[float, Request]]
"""Requests with the seconds, from the start on, at which they are due; ascending."""


async def offer(target: Target, schedule: Schedule, limits: Limits, observer: Observer, fixed: bytes = b"") -> None:
    """Send each request when it is due: an open loop. Returns when all that was sent has ended.

    fixed: header lines that all requests have, each with its end, beside `Host`.
    Raises BadTarget if there is no connection to begin with.
    """
    load = _Load(target, limits, observer, fixed)
    await load.run(iter(schedule), closed=False)


async def saturate(
    target: Target, requests: Iterable[Request], limits: Limits, observer: Observer, fixed: bytes = b""
) -> None:
    """Send over each connection a request as soon as the one before is answered: a closed loop. Else as `offer`."""
    load = _Load(target, limits, observer, fixed)
    await load.run(((0.0, request) for request in requests), closed=True)


class _Load:
    """One run.

    A request is waiting (due, without a connection), asked, or ended. Connections are idle, asked, or being opened;
    one that is lost is opened again when somebody waits for it.
    """

    def __init__(self, target: Target, limits: Limits, observer: Observer, fixed: bytes) -> None:
        self._target = target
        self._limits = limits
        self._observer = observer
        self._fixed = f"Host: {target.authority}\r\n".encode() + fixed
        self._idle: list[Connection] = []
        self._asked: dict[Connection, Exchange] = {}
        self._waiting: deque[Exchange] = deque()
        self._opening: set[asyncio.Task[None]] = set()
        self._schedule: Iterator[tuple[float, Request]] = iter(())
        self._next: tuple[float, Request] | None = None
        self._closed_loop = False
        self._over = asyncio.Event()
        self._fault: BaseException | None = None
        self._alarm = alarm(self._send_due)

    async def run(self, schedule: Iterator[tuple[float, Request]], closed: bool) -> None:
        sweeping = None
        asyncio.get_running_loop().set_exception_handler(self._keep_fault)
        try:
            self._closed_loop = closed
            await self._open_first()
            gc.freeze()  # what is there now is not looked through again while answers are timed
            self._schedule = itertools.islice(schedule, self._limits.requests)
            self._advance()
            sweeping = asyncio.create_task(self._sweep())
            self._started = time.perf_counter()
            self._observer.begun(self._started)
            for connection in tuple(self._idle) if closed else ():
                self._idle.remove(connection)
                self._free(connection)
            self._send_due()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._over.wait(), self._limits.seconds + self._limits.timeout)
        finally:
            gc.unfreeze()
            asyncio.get_running_loop().set_exception_handler(None)
            self._end(sweeping)
        if self._fault:
            raise self._fault

    def _keep_fault(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """End the load on an error in a callback, of a schedule or an observer, which the loop would only log."""
        self._fault = self._fault or context.get("exception") or RuntimeError(context["message"])
        self._over.set()

    async def _open_first(self) -> None:
        wanted = self._limits.connections if self._closed_loop else min(self._limits.connections, OPENED_MAX)
        opened = await asyncio.gather(*(self._connect() for _ in range(wanted)), return_exceptions=True)
        for connection in opened:
            if isinstance(connection, Connection):
                self._idle.append(connection)
        if not self._idle:
            where = f"{self._target.address} port {self._target.port}"
            raise BadTarget(f"no connection to {where}: {opened[0]}")

    async def _connect(self) -> Connection:
        loop, target = asyncio.get_running_loop(), self._target
        async with asyncio.timeout(self._limits.timeout):
            _, connection = await loop.create_connection(
                lambda: Connection(self._fixed, self._free, self._lost),
                target.address,
                target.port,
                ssl=target.tls,
                server_hostname=target.name if target.tls else None,
            )
        return connection

    def _advance(self) -> None:
        """Take the next request of the schedule; None if there is none, or if it is due after the end."""
        following = next(self._schedule, None)
        self._next = following if following and following[0] < self._limits.seconds else None

    def _send_due(self) -> None:
        """Send what is due, and set the alarm to what comes next. In a closed loop connections ask for themselves."""
        if self._closed_loop:
            self._finish_if_over()
            return
        for _ in range(BURST_MAX):
            now = time.perf_counter()
            if self._next is None or self._started + self._next[0] > now:
                break
            self._give(Exchange(self._next[1], self._started + self._next[0]))
            self._advance()
        if self._next:
            self._alarm.set(self._started + self._next[0])
        else:
            self._finish_if_over()

    def _give(self, exchange: Exchange) -> None:
        in_flight = len(self._asked) + len(self._waiting)
        if in_flight >= self._limits.in_flight:
            self._observer.due(exchange, True, in_flight)
            self._observer.unsent(exchange)
        elif self._idle:
            self._ask(self._idle.pop(), exchange)
            self._observer.due(exchange, False, in_flight + 1)
        else:
            self._waiting.append(exchange)
            self._observer.due(exchange, True, in_flight + 1)
            self._open_more()

    def _ask(self, connection: Connection, exchange: Exchange) -> None:
        self._asked[connection] = exchange
        connection.ask(exchange)

    def _free(self, connection: Connection) -> None:
        """A connection has its answer, or is new: give it what waits."""
        self._report(self._asked.pop(connection, None))
        if self._waiting:
            self._ask(connection, self._waiting.popleft())
        elif exchange := self._next_of_closed_loop():
            self._ask(connection, exchange)
            self._observer.due(exchange, False, len(self._asked))
        else:
            self._idle.append(connection)
            self._finish_if_over()

    def _next_of_closed_loop(self) -> Exchange | None:
        """Return what is due because a connection is free: the next request of a closed loop, while it lasts."""
        now = time.perf_counter()
        if not (self._closed_loop and self._next and now < self._started + self._limits.seconds):
            return None
        exchange = Exchange(self._next[1], now)
        self._advance()
        return exchange

    def _lost(self, connection: Connection) -> None:
        if connection in self._idle:
            self._idle.remove(connection)
        last = connection.exchange
        self._report(self._asked.pop(connection, None) or (last if last.failure else None))
        self._open_more()
        self._finish_if_over()

    def _open_more(self) -> None:
        """Open a connection for each request that waits, in a closed loop for each that is missing."""
        room = self._limits.connections - len(self._asked) - len(self._idle) - len(self._opening)
        missing = len(self._waiting) - len(self._opening)
        for _ in range(room if self._closed_loop and self._next else min(room, missing)):
            task = asyncio.create_task(self._open())
            self._opening.add(task)

    async def _open(self) -> None:
        """Open a connection. If there is none, whoever has waited longest has failed; a closed loop tries no more."""
        try:
            connection = await self._connect()
        except OSError as error:
            self._opening.discard(asyncio.current_task())
            exchange = self._waiting.popleft() if self._waiting else self._next_of_closed_loop()
            if exchange:
                exchange.sent = exchange.ended = time.perf_counter()
                exchange.failure, exchange.detail = "no-connection", str(error)
                self._report(exchange)
            if not self._closed_loop:
                self._open_more()
            self._finish_if_over()
        else:
            self._opening.discard(asyncio.current_task())
            self._free(connection)

    def _report(self, exchange: Exchange | None) -> None:
        if exchange:
            self._observer.ended(exchange)

    async def _sweep(self) -> None:
        """End the requests that wait for an answer for too long; the first that was asked is the first here."""
        while True:
            await asyncio.sleep(min(SWEEP_SECONDS, self._limits.timeout / 4))
            late = time.perf_counter() - self._limits.timeout
            while self._asked and (asked := next(iter(self._asked.items())))[1].sent < late:
                connection = asked[0]
                connection.fail("timeout", f"no whole answer within {self._limits.timeout:g} s")

    def _finish_if_over(self) -> None:
        if not (self._asked or self._waiting or self._opening or (self._next and not self._closed_loop)):
            self._over.set()

    def _end(self, sweeping: asyncio.Task[None] | None) -> None:
        """Leave nothing behind: what is still asked has failed, what still waits was not sent."""
        for task in (sweeping, *self._opening):
            if task:
                task.cancel()
        self._alarm.close()
        self._next = None
        waiting, self._waiting = self._waiting, deque()
        for exchange in waiting:
            self._observer.unsent(exchange)
        for connection in tuple(self._asked):
            connection.fail("timeout", "no whole answer when the load ended")
        for connection in self._idle:
            connection.close()
