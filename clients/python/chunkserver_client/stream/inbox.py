"""What a game was told and has not taken yet: so much, and no more."""

from collections import deque
from typing import Final, NamedTuple

from chunkserver_client.stream.chunks import Chunks, Refresh
from chunkserver_client.stream.messages import Ack, Edits, Nack, Progress, Resync, Stale
from chunkserver_client.stream.session import StartOver

EVENTS_MAX: Final = 1024
BYTES_MAX: Final = 1 << 20
"""Of the frames that the events came in. As objects they have some ten times as many."""


class Skipped(NamedTuple):
    """Events up to a revision were dropped: they were not taken in time. What they have changed is in the refreshes.

    The answers to own edits among them have reached those who wait for them.
    """

    revision: int


Told = Ack | Nack | Edits | Progress | Stale | Resync | StartOver | Skipped | Refresh
"""What a game is told."""


class Inbox:
    """Events in their order; behind them what is to be fetched, which is asked for when all else is taken."""

    def __init__(self) -> None:
        self._events: deque[tuple[Told, int]] = deque()
        self._bytes = 0
        self._refreshes: deque[Refresh] = deque()

    def put(self, event: Told, size: int, revision: int) -> None:
        """Add an event. size: bytes of its frame. revision: known with it; if there is no room, all up to it goes."""
        if isinstance(event, StartOver):
            self._refreshes.clear()
        self._events.append((event, size))
        self._bytes += size
        if len(self._events) > EVENTS_MAX or self._bytes > BYTES_MAX:
            over = [(each, 0) for each, _ in self._events if isinstance(each, StartOver)][-1:]
            self._events = deque([*over, (Skipped(revision), 0)])
            self._bytes = 0

    def take(self, chunks: Chunks) -> Told | None:
        """Return what comes next; None if there is nothing."""
        if self._events:
            event, size = self._events.popleft()
            self._bytes -= size
            return event
        if not self._refreshes:
            self._refreshes.extend(chunks.take())
        return self._refreshes.popleft() if self._refreshes else None
