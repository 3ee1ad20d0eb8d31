"""All connections of one server: their limits, how many there may be, and a look at each of them every second.

    accepted -> silent -> HEAD -> answering -> idle -> HEAD -> ...
                  |        |          |          |
               too long: closed, or answered for the last time

A look counts for how long a connection has been waiting for the same thing. That costs a request nothing: no timer is
set and no clock is read on its way.
"""

import asyncio
import math
from abc import ABC, abstractmethod
from collections.abc import Set
from dataclasses import dataclass
from operator import itemgetter
from typing import Final

from chunkserver.server.share import Shares

LOOK_SECONDS: Final = 1.0
"""Between two looks, at most: a deadline may pass by two of these before the connection is ended."""
LOOKS_MIN: Final = 4
"""Within the shortest deadline."""
LOOKS_MAX: Final = 1 << 31
"""In a wait without a deadline: 68 years of looks."""
PARTING_MAX: Final = 256
"""Connections beyond `connections_max` that are held open until they have read why they are refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionLimits:
    """What bounds a connection, and all of them together. Seconds are met to within two seconds.

    connections_max: open at once. In a full server the one that has waited longest without a request gives way to a new
        one; if all are busy, the new one is refused. There is no limit by address: behind one address may be a proxy,
        or a school.
    header_seconds: for the head of a request to arrive, from the moment when one may begin.
    keep_alive_seconds: between an answer and the next request.
    send_seconds: for a client to make room when it is sent more than its connection holds. An answer of 600 KB then
        needs 20 KB/s.
    linger_seconds: for a client to take note that its connection is over.
    url_bytes_max: of a URL, path and query.
    head_bytes_max: of the URL and the names and values of all header fields.
    head_fields_max: header fields of a request.
    body_bytes_max: of a request's body that are read at all, framing included, whoever reads them. What each resource
        takes is less, edits with raw boxes too.
    pipelined_max: requests of one connection that wait behind the one being answered. Those are answered; what comes
        behind them is not, and the connection is closed.
    """

    connections_max: int = 4096
    header_seconds: float = 10.0
    keep_alive_seconds: float = 15.0
    send_seconds: float = 30.0
    linger_seconds: float = 2.0
    url_bytes_max: int = 8 << 10
    head_bytes_max: int = 32 << 10
    head_fields_max: int = 100
    body_bytes_max: int = 9 << 20
    pipelined_max: int = 16

    @property
    def look_seconds(self) -> float:
        """Between two looks at each connection."""
        shortest = min(self.header_seconds, self.keep_alive_seconds, self.send_seconds, self.linger_seconds)
        return min(LOOK_SECONDS, shortest / LOOKS_MIN)


LIMITS_DEFAULT: Final = ConnectionLimits()


class Watched(ABC):
    """A connection as `Connections` sees it."""

    __slots__ = ()

    @abstractmethod
    def look(self) -> int:
        """End what is overdue. Return how many looks in a row have found it waiting for a request; 0 if it does not."""

    @abstractmethod
    def give_way(self) -> bool:
        """End the connection if it still waits as the last look has found it; return whether it did."""


class Connections:
    """All connections of one server. Belongs to the event loop.

    ended: how many were ended by the server before their clients left, by why.
    shares: of the event loop's time, for peers of streams.
    """

    def __init__(self, limits: ConnectionLimits = LIMITS_DEFAULT) -> None:
        self.limits = limits
        self.shares = Shares()
        self.ended: dict[str, int] = {}
        self._open: Set[object] = frozenset()
        self._parting: set[Watched] = set()
        self._waiting: list[tuple[int, Watched]] = []
        self._timer: asyncio.TimerHandle | None = None

    @property
    def open(self) -> int:
        """How many are open."""
        return len(self._open) + len(self._parting)

    def looks_in(self, seconds: float) -> int:
        """Return how many looks, after the first, find the same wait before it has lasted for `seconds`."""
        return math.ceil(min(seconds / self.limits.look_seconds, LOOKS_MAX))

    def count(self, why: str) -> None:
        """Count a connection that was ended."""
        self.ended[why] = self.ended.get(why, 0) + 1

    def admit(self, opened: Set[object]) -> bool:
        """Return whether there is room for the newest of all open connections `opened`; make it if that can be."""
        self._open = opened
        if self._timer is None:
            self._look_later()
        return len(opened) <= self.limits.connections_max or self._make_room()

    def see_off(self, refused: Watched) -> bool:
        """Return whether a connection that was not admitted may stay open until its client has read why."""
        if len(self._parting) >= PARTING_MAX:
            return False
        self._parting.add(refused)
        return True

    def forget(self, gone: Watched) -> None:
        """A connection is closed."""
        self._parting.discard(gone)

    def _make_room(self) -> bool:
        while self._waiting:
            _, longest = self._waiting.pop()
            if longest.give_way():
                return True
        return False

    def _look_later(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self.limits.look_seconds, self._look)

    def _look(self) -> None:
        watched = [one for one in (*self._open, *self._parting) if isinstance(one, Watched)]
        looked = [(one.look(), one) for one in watched]
        self._waiting = sorted((pair for pair in looked if pair[0]), key=itemgetter(0))
        self._timer = None
        if watched:
            self._look_later()
