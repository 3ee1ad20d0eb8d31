"""Sets of places along a row, as the bits of 64-bit words: counted and walked a word at a time.

Place x is bit `x & 63` of word `x >> 6`. Written out in plain arithmetic, which the compiler recognises and turns into
the machine's own instructions where it has them; the value is the same either way.
"""

from typing import Final

import numpy as np

from chunkserver.kernel import inlined

WORD_BITS: Final = 64

_ONE: Final = np.uint64(1)
_PAIRS: Final = np.uint64(0x5555555555555555)
_NIBBLES: Final = np.uint64(0x3333333333333333)
_BYTES: Final = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM: Final = np.uint64(0x0101010101010101)


def words_for(places: int) -> int:
    """Return how many words hold `places` bits."""
    return (places + WORD_BITS - 1) // WORD_BITS


@inlined
def popcount(word: np.uint64) -> int:
    """Return how many bits are set."""
    word = word - ((word >> _ONE) & _PAIRS)
    word = (word & _NIBBLES) + ((word >> np.uint64(2)) & _NIBBLES)
    word = (word + (word >> np.uint64(4))) & _BYTES
    return int(np.int64((word * _SUM) >> np.uint64(56)))


@inlined
def lowest(word: np.uint64) -> int:
    """Return the place of the lowest set bit of a word that is not 0."""
    return popcount((word & (~word + _ONE)) - _ONE)


@inlined
def without_lowest(word: np.uint64) -> np.uint64:
    """Return the word with its lowest set bit cleared."""
    return word & (word - _ONE)


@inlined
def below(place: int) -> np.uint64:
    """Return the word with all bits below `place` set, 0 <= place < 64."""
    return (_ONE << np.uint64(place)) - _ONE


@inlined
def first_places(places: int, word: int) -> np.uint64:
    """Return word number `word` of the set of the first `places` places."""
    left = places - word * WORD_BITS
    if left >= WORD_BITS:
        return ~np.uint64(0)
    return below(left) if left > 0 else np.uint64(0)
