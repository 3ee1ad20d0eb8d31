"""Lines of a log that would be too many."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Final

SECONDS_MIN: Final = 1.0
"""Between two lines."""


class Seldom:
    """Logs a line, unless there was one within SECONDS_MIN; then it counts, and the next one says how many it was.

    clock: seconds that only rise. Safe in any thread.
    """

    def __init__(self, log: logging.Logger, level: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._level, self._clock = log, level, clock
        self._lock = threading.Lock()
        self._quiet_until = -float("inf")
        self._left_out = 0

    def __call__(self, message: str, *values: object) -> None:
        with self._lock:
            now = self._clock()
            if now < self._quiet_until:
                self._left_out += 1
                return
            left_out, self._left_out, self._quiet_until = self._left_out, 0, now + SECONDS_MIN
        if left_out:
            message, values = f"{message} (and %d times before)", (*values, left_out)
        self._log.log(self._level, message, *values)
