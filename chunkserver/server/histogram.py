"""How long things took, counted in buckets: cheap to fill while requests are served, read when metrics are wanted."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Final

SECONDS: Final = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
"""Upper ends of the buckets, from a tenth of a millisecond to the deadline of a build."""


class Histogram:
    """Counts values by bucket. One event loop owns it.

    bounds: ascending upper ends, each included in its bucket. counts: one more, for what lies above the last of them.
    total: the sum of all values.
    """

    def __init__(self, bounds: Sequence[float] = SECONDS) -> None:
        self.bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def observe(self, value: float) -> None:
        """Count `value`."""
        self.counts[bisect_left(self.bounds, value)] += 1
        self.total += value
