"""What is counted of requests. Plain numbers, to be read whenever metrics are asked for."""

from dataclasses import dataclass, field
from typing import Final

from chunkserver.server.histogram import Histogram

METHODS: Final = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
OTHER: Final = "other"
"""A method that is none of these, and the route of a path that has none. So nobody can make up new counters."""


@dataclass(slots=True)
class RequestCounts:
    """Counts from the start of the server on; one event loop owns it.

    in_flight: requests that are being answered.
    answered: by the template of the route, the method and the status.
    seconds: by the template of the route, until the last byte of the answer was handed on.
    unlogged: lines that were left out of the log because there were too many.
    """

    in_flight: int = 0
    answered: dict[tuple[str, str, int], int] = field(default_factory=dict)
    seconds: dict[str, Histogram] = field(default_factory=dict)
    unlogged: int = 0

    def count_refusal(self, method: str, status: int) -> None:
        """Count an answer that was given before a route was looked for."""
        key = (OTHER, method if method in METHODS else OTHER, status)
        self.answered[key] = self.answered.get(key, 0) + 1

    def count(self, route: str, method: str, status: int, seconds: float) -> None:
        """Count one answer."""
        key = (route, method if method in METHODS else OTHER, status)
        self.answered[key] = self.answered.get(key, 0) + 1
        if route not in self.seconds:
            self.seconds[route] = Histogram()
        self.seconds[route].observe(seconds)
