"""Words of bits against Python's own integers."""

import numpy as np
import pytest

from chunkserver.kernel import kernel
from chunkserver.mesher import bits

EDGES = [0, 1, 1 << 63, (1 << 64) - 1, 1 << 32, (1 << 32) - 1, 0x5555555555555555, 0xAAAAAAAAAAAAAAAA]


@kernel
def _all_of(word, place, places, number):
    counted, start = bits.popcount(word), bits.below(place)
    lowest = bits.lowest(word) if word != 0 else -1
    return counted, lowest, bits.without_lowest(word), start, bits.first_places(places, number)


def test_like_integers(rng):
    words = EDGES + [1 << place for place in range(64)] + rng.integers(0, 1 << 64, 500, np.uint64).tolist()
    for word in words:
        place, places, number = int(rng.integers(64)), int(rng.integers(1, 129)), int(rng.integers(2))
        assert _all_of(np.uint64(word), place, places, number) == (
            word.bit_count(),
            (word & -word).bit_length() - 1,
            word & (word - 1),
            (1 << place) - 1,
            ((1 << places) - 1) >> 64 * number & (1 << 64) - 1,
        )


@pytest.mark.parametrize(("places", "words"), [(1, 1), (17, 1), (33, 1), (64, 1), (65, 2), (128, 2), (129, 3)])
def test_words_for(places, words):
    assert bits.words_for(places) == words
