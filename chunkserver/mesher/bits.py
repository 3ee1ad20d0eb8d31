"""Sets of places along a row, as the bits of a 64-bit word: counted and walked a bit at a time.

Written out in plain arithmetic, which the compiler recognises and turns into the machine's own instructions where it
has them; the value is the same either way.
"""

from typing import Final

import numpy as np

from chunkserver.kernel import inlined

ONE: Final = np.uint64(1)

_PAIRS: Final = np.uint64(0x5555555555555555)
_NIBBLES: Final = np.uint64(0x3333333333333333)
_BYTES: Final = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM: Final = np.uint64(0x0101010101010101)


@inlined
def popcount(word: np.uint64) -> np.uint64:
    """Return how many bits are set."""
    word = word - ((word >> ONE) & _PAIRS)
    word = (word & _NIBBLES) + ((word >> np.uint64(2)) & _NIBBLES)
    word = (word + (word >> np.uint64(4))) & _BYTES
    return np.uint64((word * _SUM) >> np.uint64(56))


@inlined
def lowest(word: np.uint64) -> np.uint64:
    """Return the place of the lowest set bit of a word that is not 0."""
    return np.uint64(popcount((word & (~word + ONE)) - ONE))


@inlined
def without_lowest(word: np.uint64) -> np.uint64:
    """Return the word with its lowest set bit cleared."""
    return word & (word - ONE)


@inlined
def below(place: np.uint64) -> np.uint64:
    """Return the word with all bits below `place` set, 0 <= place < 64."""
    return (ONE << place) - ONE
