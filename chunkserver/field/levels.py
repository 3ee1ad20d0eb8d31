"""Band-limited levels: how much of a feature is left at a level of detail. One rule, in this one place.

Sampled every `step` voxels, a feature of `size` voxels (one lattice cell of noise) is whole from 8 steps up, gone at 4
steps and less, and fades linearly in between towards its mean. LOD 0 is the recipe itself: nothing fades.

    weight 1 |          ______
             |         /
           0 |________/
             0   4    8       size / step
"""

from typing import Final

STEPS_GONE: Final = 4.0
STEPS_WHOLE: Final = 8.0

assert 2.0 < STEPS_GONE < STEPS_WHOLE, "a feature must be gone before its sampling aliases (two steps a period)"


def weight(size: float, lod: int) -> float:
    """Return the weight in [0, 1] of a feature of `size` voxels at level `lod`."""
    if lod == 0:
        return 1.0
    steps = size / (1 << lod)
    return min(1.0, max(0.0, (steps - STEPS_GONE) / (STEPS_WHOLE - STEPS_GONE)))
