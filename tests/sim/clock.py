"""A clock that nobody waits for: what is to happen happens in its order, at once."""

import heapq
from collections.abc import Callable
from itertools import count


class Clock:
    """Virtual seconds. Things that are to happen at the same time happen in the order in which they were asked for."""

    def __init__(self) -> None:
        self.now = 0.0
        self._turns: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()

    def __call__(self) -> float:
        return self.now

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._turns, (self.now + seconds, next(self._numbers), action))

    def run(self, until: float, is_done: Callable[[], bool] = lambda: False) -> None:
        """Have everything happen up to a time, or until it is done."""
        while not is_done():
            if not self._turns or self._turns[0][0] > until:
                self.now = until
                return
            self.now, _, action = heapq.heappop(self._turns)
            action()
