"""How much of the event loop one peer may have: what it sends is taken as fast as that leaves time for others.

A loop without a pause is worse than a busy one: the threads that write edits wait for the interpreter at each of their
steps then, and every player's acknowledgement for them. So a peer that has had its share is not read until the loop
has rested. It is not told; it cannot send on, as soon as what lies between is full.

    its own: BURST_SECONDS, which come back with OWN_SHARE of the time      what a player sends never takes more
    beyond:  a pause of REST times what it took, one behind another's       who sends more; all of them together
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

OWN_SHARE: Final = 0.02
"""Of the loop's time, for each peer. On two cores with a load of ten, 20 edits and 20 changes of 4 regions a second had
no pause, and 100 edits a second had 4 short ones."""
BURST_SECONDS: Final = 0.05
"""Of the loop's time, for a peer at once."""
REST: Final = 5.0
"""Seconds of pause for each second beyond a peer's own share: all that goes beyond is a fifth of the loop's time."""
TURN_SECONDS: Final = 0.001
"""Of the loop's time, that a peer may take before a pause: timers of the loop are no finer."""
COUNTED_SECONDS_MAX: Final = 0.01
"""Of one message or piece, however long it was: what takes more is a loop that had to wait for its own turn."""


class Shares:
    """The shares of all peers of one server.

    pauses: how many there have been.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """clock: seconds, never going back."""
        self.clock = clock
        self.pauses = 0
        self._rested_at = clock()

    def rest(self, seconds: float) -> float:
        """Return when the loop has rested for work of `seconds`, and for all that was to be rested for before."""
        self.pauses += 1
        self._rested_at = max(self._rested_at, self.clock()) + REST * seconds
        return self._rested_at


class Share:
    """What one peer has of the loop's time."""

    def __init__(self, shares: Shares) -> None:
        self._shares, self._clock = shares, shares.clock
        self._left = BURST_SECONDS
        self._seen_at = self._until = shares.clock()

    @property
    def rest_seconds(self) -> float:
        """How long nothing more of this peer should be taken; 0 if it may be now."""
        return max(0.0, self._until - self._clock())

    @contextmanager
    def used(self) -> Iterator[None]:
        """Count the time of a block, which waits for nothing."""
        begun = self._clock()
        try:
            yield
        finally:
            self._count(begun)

    def _count(self, begun: float) -> None:
        now = self._clock()
        returned = OWN_SHARE * (now - self._seen_at)
        self._seen_at = now
        self._left = min(self._left + returned, BURST_SECONDS) - min(now - begun, COUNTED_SECONDS_MAX)
        if self._left < -TURN_SECONDS:
            self._until = self._shares.rest(-self._left)
            self._left = 0.0
