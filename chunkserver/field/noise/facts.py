"""What may be relied on of each noise: its range, its means, how steep it is.

`tests/unit/field/test_noise_facts.py` and `test_noise_statistics.py` hold each number.
"""

from types import MappingProxyType
from typing import Final, NamedTuple


class NoiseFacts(NamedTuple):
    """What is known of one noise. Lengths are lattice cells.

    low, high: what no value is outside of.
    mean: at jitter 0; with jitter it grows by `mean_by_jitter` * jitter^2, which is right to 0.003. See `mean_at`.
    mean_absolute: of |noise|, right to 0.001; what ridged and billow sums fade to.
    lipschitz: two values differ by at most this times the distance of their points, but for rounding (2e-6).
    """

    dimensions: int
    low: float
    high: float
    mean: float
    mean_absolute: float
    lipschitz: float
    mean_by_jitter: float = 0.0

    def mean_at(self, jitter: float) -> float:
        """Return the mean of a cellular noise at a jitter in [0, 1]; other noises have none, and the same mean."""
        return self.mean + self.mean_by_jitter * jitter * jitter


_JUMPS: Final = float("inf")

NOISES: Final = MappingProxyType(
    {
        # Slopes: the supremum over points, directions and gradients, found by a search, and 0.1 % more or so. For value
        # noise the search ends at 2 from one corner to the next, times 15/8, the steepest slope of the quintic blend.
        "gradient2": NoiseFacts(2, -1.0, 1.0, 0.0, 0.2533, 2.95),
        "gradient3": NoiseFacts(3, -1.0, 1.0, 0.0, 0.2173, 3.6),
        "value2": NoiseFacts(2, -1.0, 1.0, 0.0, 0.3786, 3.75),
        "value3": NoiseFacts(3, -1.0, 1.0, 0.0, 0.3301, 3.75),
        "simplex2": NoiseFacts(2, -1.0, 1.0, 0.0, 0.4678, 7.37),
        "simplex3": NoiseFacts(3, -1.0, 1.0, 0.0, 0.3136, 6.97),
        # A distance is 1-Lipschitz, a difference of two 2-Lipschitz; a value jumps where the nearest point changes.
        "cellular2 distance": NoiseFacts(2, 0.0, 1.0, 0.3825, 0.3825, 1.0, 0.0480),
        "cellular2 edge": NoiseFacts(2, 0.0, 1.0, 0.3170, 0.3170, 2.0, -0.0510),
        "cellular2 value": NoiseFacts(2, -1.0, 1.0, 0.0, 0.5, _JUMPS),
        "cellular3 distance": NoiseFacts(3, 0.0, 1.0, 0.4805, 0.4805, 1.0, 0.0420),
        "cellular3 edge": NoiseFacts(3, 0.0, 1.0, 0.2245, 0.2245, 2.0, -0.0280),
        "cellular3 value": NoiseFacts(3, -1.0, 1.0, 0.0, 0.5, _JUMPS),
    }
)
"""The facts of every noise by its name; those of cellular noise by its name and what it returns."""
