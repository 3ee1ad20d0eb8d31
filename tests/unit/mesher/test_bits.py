"""Words of bits against Python's own integers."""

import numpy as np

from chunkserver.kernel import kernel
from chunkserver.mesher import bits

EDGES = [0, 1, 1 << 63, (1 << 64) - 1, 1 << 32, (1 << 32) - 1, 0x5555555555555555, 0xAAAAAAAAAAAAAAAA]


@kernel
def _all_of(word, place):
    counted, start = bits.popcount(word), bits.below(place)
    lowest = bits.lowest(word) if word != 0 else np.uint64(64)
    return counted, lowest, bits.without_lowest(word), start


def test_like_integers(rng):
    words = EDGES + [1 << place for place in range(64)] + rng.integers(0, 1 << 64, 500, np.uint64).tolist()
    for word in words:
        place = int(rng.integers(64))
        assert _all_of(np.uint64(word), np.uint64(place)) == (
            word.bit_count(),
            (word & -word).bit_length() - 1 if word else 64,
            word & (word - 1) if word else 0,
            (1 << place) - 1,
        )
