"""How near a chunk has to be to be split, level by level: docs/level-of-detail.md, "Split distances" and "Limits"."""

from collections.abc import Sequence
from itertools import accumulate
from typing import Final, NamedTuple

WIDTHS_MAX: Final = 16
"""Nothing is split that is further away than so many times its own width."""
RAISES_MAX: Final = 8
"""How often the pixels of error are raised by a third before whole levels are given up."""


class Rung(NamedTuple):
    """What is wanted, as distances in whole voxels.

    reach: chunks of the last level are there if they are nearer.
    split: by LOD: chunks are split if they are nearer. Those of LOD 0 never are.
    """

    reach: int
    split: tuple[int, ...]

    def roomy(self) -> "Rung":
        """Return what is wanted at most while a viewer trembles."""
        return Rung(kept(self.reach), tuple(map(kept, self.split)))


def kept(distance: int) -> int:
    """Return how near a chunk has to be to stay as near ones are."""
    return distance + distance // 4


def rungs(cells: int, errors: Sequence[float], sharpness: float, reach: int) -> list[Rung]:
    """Return what is wanted first, and then less and less: the last rung has less than 64 chunks.

    errors: by LOD: how far the surface may be off, in voxels.
    sharpness: how many times its error's size away from the viewer a chunk has to be.
    reach: voxels.
    """
    sides = [cells << lod for lod in range(len(errors))]
    wanted = [
        int(min(error * sharpness, float(WIDTHS_MAX * side)))
        for error, side in zip(accumulate(errors, max), sides, strict=True)
    ]
    raised = [[distance * 3**times // 4**times for distance in wanted] for times in range(RAISES_MAX + 1)]
    dropped = [[0] * finest + raised[-1][finest:] for finest in range(2, len(errors) + 1)]
    found = [Rung(reach, (0, *row[1:])) for row in raised + dropped]
    nothing = (0,) * len(errors)
    while (reach := reach * 3 // 4) > sides[-1] // 2:
        found.append(Rung(reach, nothing))
    found.append(Rung(sides[-1] // 2, nothing))
    return list(dict.fromkeys(found))
