"""Tickets for WebSockets of browsers, which can send no header with them: good once, and not for long."""

import secrets
import time
from collections.abc import Callable
from typing import Final, NamedTuple

from chunkserver.errors import Overloaded
from chunkserver.server.keys import Scope

TICKET_BYTES: Final = 32
TICKET_SECONDS: Final = 30.0
TICKETS_MAX: Final = 10_000
"""That are not used yet."""


class Ticket(NamedTuple):
    """What a ticket is good for: a path, in the name of a key, with its scope."""

    path: str
    name: str
    scope: Scope


class Tickets:
    """The tickets of one server. clock: seconds, never going back."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kept: dict[str, tuple[float, Ticket]] = {}

    def mint(self, ticket: Ticket) -> str:
        """Return a new token for it. Raises `Overloaded` if too many are not used yet."""
        now = self._clock()
        while self._kept and next(iter(self._kept.values()))[0] <= now:
            del self._kept[next(iter(self._kept))]
        if len(self._kept) >= TICKETS_MAX:
            raise Overloaded(f"{TICKETS_MAX} tickets are not used yet")
        token = secrets.token_urlsafe(TICKET_BYTES)
        self._kept[token] = now + TICKET_SECONDS, ticket
        return token

    def take(self, token: str, path: str) -> Ticket | None:
        """Return what a token is good for, once; None if it is good for nothing, or for another path."""
        until, ticket = self._kept.pop(token, (0.0, None))
        return ticket if ticket is not None and until > self._clock() and ticket.path == path else None
