"""Band-limited levels: how much of a feature is left at a level of detail. One rule, in this one place.

Sampled every `step` voxels, a feature of `size` voxels (one lattice cell of noise, twice the depth of a shape, one
period of a repetition) is whole from 8 steps up, gone at 4 steps and less, and fades linearly in between. LOD 0 is the
recipe itself: nothing fades.

    weight 1 |          ______
             |         /
           0 |________/
             0   4    8       size / step

Noise and repetitions fade towards their mean. A shape shrinks evenly: what it loses is added to its distance, until at
weight 0 nothing is inside. `scale` makes the features of its subtree as much larger; `detail` says to take them so.

What has faded may leave a cut behind that cuts nothing: caves that are gone are rock, a few voxels deep in density, at
every depth. A surface interpolated towards that constant lies wrong as soon as a cell is larger than those few voxels,
and has the wrong normals. So a level's tape leaves out what can no longer show: `chunkserver.field.flatten.visible`.
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
