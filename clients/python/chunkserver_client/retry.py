"""Whether to ask again, and when: exponential backoff with full jitter, bounded in count and in time."""

import math
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from typing import Final, NoReturn

from chunkserver_client.errors import ClientError, Unavailable, Unreachable

EXPONENT_MAX: Final = 30
"""Of the backoff's doubling: far beyond any `backoff_seconds_max`, and within what a float can say."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Retry:
    """How patient a client is.

    attempts_max: how often something is asked for, the first time included; 1 is never again.
    seconds_max: for all of them together, and for the pauses. A batch has that long for each chunk that it gains.
    backoff_seconds: the n-th pause is random, up to `backoff_seconds * 2**n`.
    backoff_seconds_max: and up to this.

    `Retry-After` is honoured: the pause is at least that long. If that is longer than the time that is left, the client
    gives up at once.
    """

    attempts_max: int = 8
    seconds_max: float = 60.0
    backoff_seconds: float = 0.1
    backoff_seconds_max: float = 5.0

    def __post_init__(self) -> None:
        seconds = (self.seconds_max, self.backoff_seconds, self.backoff_seconds_max)
        if self.attempts_max < 1 or not all(math.isfinite(value) and value >= 0 for value in seconds):
            raise ValueError(f"{self}: at least one attempt, and finite seconds, none below 0")


class Trial:
    """The attempts at one thing: how many there were, and how much time is left."""

    def __init__(
        self,
        retry: Retry,
        clock: Callable[[], float] = time.monotonic,
        jitter: Callable[[float, float], float] = random.uniform,
    ) -> None:
        self._retry = retry
        self._clock = clock
        self._jitter = jitter
        self.renew()

    def renew(self) -> None:
        """Begin anew: something was gained."""
        self._failures = 0
        self._deadline = self._clock() + self._retry.seconds_max

    @property
    def seconds_left(self) -> float:
        """Seconds until the deadline; below 0 when it has passed."""
        return self._deadline - self._clock()

    def pause_after(self, error: Exception) -> float:
        """Return how long to wait after `error`. Raises it when that was the last attempt.

        An error of the connection is raised as `Unreachable`, with itself as the cause.
        """
        self._failures += 1
        longest = min(
            self._retry.backoff_seconds_max,
            self._retry.backoff_seconds * 2.0 ** min(self._failures - 1, EXPONENT_MAX),
        )
        asked = error.retry_after if isinstance(error, Unavailable) else 0.0
        pause = asked + self._jitter(0.0, longest)
        if self._failures >= self._retry.attempts_max or pause >= self.seconds_left:
            give_up(error, self._failures)
        return pause


def give_up(error: Exception, attempts: int = 1) -> NoReturn:
    """Raise what the caller of a call gets for `error`."""
    if isinstance(error, ClientError):
        raise error
    raise Unreachable(f"no whole answer in {attempts} attempts: {str(error) or type(error).__name__}") from error


def retry_after(headers: Mapping[str, str], now: Callable[[], float] = time.time) -> float:
    """Return the seconds of `Retry-After`, a number or a date; 0 if it is missing or neither."""
    text = headers.get("retry-after", "").strip()
    if text.isascii() and text.isdecimal():
        return float(text[:EXPONENT_MAX])
    try:
        return max(0.0, parsedate_to_datetime(text).timestamp() - now())
    except (ValueError, OverflowError, OSError):
        return 0.0
