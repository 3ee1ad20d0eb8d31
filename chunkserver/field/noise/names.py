"""What tells one noise of a world from another: where its lattice begins, and the keys of its hash."""

from typing import Final

_MASK: Final = (1 << 64) - 1
_WORD: Final = (1 << 32) - 1
_GOLDEN: Final = 0x9E3779B97F4A7C15
"""2**64 / golden ratio, odd: the step of SplitMix64 (S. Vigna)."""


def noise_name(seed: int, salt: int, octave: int) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Return what tells noises apart, for each axis: an offset in [0, 1) lattice cells and a 32-bit hash key."""
    name = _hash(_hash(_hash(0, seed), salt), octave)
    axes = [_hash(name, axis) for axis in range(3)]
    return tuple((key >> 32) / 2.0**32 for key in axes), tuple(key & _WORD for key in axes)


def _hash(key: int, word: int) -> int:
    """Return 64 bits that all bits of key and word reach: SplitMix64's finish (S. Vigna)."""
    key = (key + word + 1) * _GOLDEN & _MASK
    key = (key ^ key >> 30) * 0xBF58476D1CE4E5B9 & _MASK
    key = (key ^ key >> 27) * 0x94D049BB133111EB & _MASK
    return key ^ key >> 31
