"""One connection between a player and the server: two pipes that keep their order, take their time, and break."""

import random
from collections import deque
from collections.abc import Callable

from chunkserver.stream import Connection, Stream, closing
from tests.sim.clock import Clock

WINDOW = 3
"""Frames that are under way to a player at most: beyond that, the server cannot send."""

Frame = str | bytes


class Wire:
    """A connection. receive: takes a frame of the server; end: is told the code when the player's end is closed.

    The server may learn that the player has left long after it: until then the player's last frames still come.
    """

    def __init__(
        self,
        clock: Clock,
        rng: random.Random,
        stream: Stream,
        receive: Callable[[Frame], None],
        end: Callable[[int | None], None],
    ) -> None:
        self._clock, self._rng = clock, rng
        self._receive, self._end = receive, end
        self._connection: Connection = stream.connect(lambda: clock.after(0.0, self._pump))
        self._down: deque[Frame] = deque()
        self._up: deque[Frame] = deque()
        self._is_cut = False
        self._is_reading = True
        self._down_at = self._up_at = 0.0

    def send(self, frames: list[Frame]) -> None:
        """Send frames to the server."""
        for frame in frames:
            self._up.append(frame)
            self._up_at = max(self._up_at, self._clock.now + self._rng.uniform(0.001, 0.04))
            self._clock.after(self._up_at - self._clock.now, self._arrive)

    def pause(self, seconds: float) -> None:
        """Have the player read nothing for a while."""
        if self._is_reading:
            self._is_reading = False
            self._clock.after(seconds, self._resume)

    def cut(self) -> None:
        """Break: nothing comes to the player any more, and some of what it has sent is lost."""
        if not self._is_cut:
            self._is_cut = True
            for _ in range(self._rng.randint(0, len(self._up))):
                self._up.pop()
            self._down.clear()
            self._clock.after(self._rng.choice((0.0, 0.01, 0.3)), lambda: self._connection.close(closing.LEFT))
            self._end(None)

    def _arrive(self) -> None:
        if self._up and not self._connection.is_paused:
            self._connection.received(self._up.popleft())
            self._pump()

    def _pump(self) -> None:
        """Move what can be moved towards the player, and read again what was not read."""
        if self._connection.closing is not None:
            self._close(self._connection.closing.code)
            return
        while len(self._down) < WINDOW and (frame := self._connection.outbox.front()) is not None:
            self._down.append(frame)
            self._connection.sent()
            self._down_at = max(self._down_at, self._clock.now + self._rng.uniform(0.001, 0.04))
            self._clock.after(self._down_at - self._clock.now, self._deliver)
        if self._up and not self._connection.is_paused:
            self._clock.after(0.001, self._arrive)

    def _deliver(self) -> None:
        if self._down and self._is_reading and not self._is_cut:
            frame = self._down.popleft()
            self._receive(frame)
            self._pump()

    def _resume(self) -> None:
        self._is_reading = True
        for _ in range(len(self._down)):
            self._clock.after(0.0, self._deliver)

    def _close(self, code: int) -> None:
        if not self._is_cut:
            self._is_cut = True
            self._clock.after(0.03, lambda: self._end(code))
