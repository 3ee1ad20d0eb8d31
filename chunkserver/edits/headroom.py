"""Overflow is refused before it is written: bounds of densities, brick by brick, of edits that are not folded yet.

Carve, fill, flatten and smooth make no density that is not between those around it, the field's limit and a distance:
they never raise the largest. So what counts is by how much `add` and `delta` can.
"""

import math
from typing import Final

import numpy as np

from chunkserver.edits.boxes import Box
from chunkserver.edits.bricks import Bricks, Key, keys_in
from chunkserver.edits.brushes import brush
from chunkserver.edits.edit import Edit
from chunkserver.edits.strokes import DELTA_MAX, FIELD_MAX, UNITS_PER_VOXEL, Add, Delta, Flatten, Smooth, Stroke
from chunkserver.errors import BadStroke

FIELD_UNITS: Final = FIELD_MAX * UNITS_PER_VOXEL
ROUNDING_UNITS: Final = 64
"""What smooth and flatten may go too far: they read densities as float32, which at 2^20 voxels are 64 units apart."""


class Headroom:
    """What is left until deltas could pass DELTA_MAX. Belongs to who decides which edits are taken, in their order."""

    def __init__(self, bricks: Bricks) -> None:
        self._bricks = bricks
        self._raised: dict[Key, tuple[int, int]] = {}

    def take(self, edit: Edit, revision: int) -> None:
        """Note an edit that will have this revision.

        Raises `BadStroke` if a delta could pass DELTA_MAX; then nothing was noted. What is known of edits that are not
        folded yet is coarse: before refusing somebody, `settle` on bricks that have them all, and ask once more.
        """
        raised: dict[Key, int] = {}
        for number, stroke in enumerate(edit.strokes):
            if by := _raises(stroke):
                box = brush(stroke).box
                around = self._largest(box.grown(1), raised) if isinstance(stroke, Smooth) else 0
                for key in keys_in(0, box):
                    raised[key] = max(self._bound(key, raised), around) + by
                    if raised[key] + FIELD_UNITS > DELTA_MAX:
                        expected = f"the stroke could make a delta pass {DELTA_MAX} units"
                        raise BadStroke.at(f"strokes.{number}", expected, limit=DELTA_MAX)
        self._raised.update((key, (bound, revision)) for key, bound in raised.items())

    def settle(self, bricks: Bricks) -> None:
        """Go on from these bricks: what was noted of edits that are in them is forgotten."""
        self._bricks = bricks
        self._raised = {key: kept for key, kept in self._raised.items() if kept[1] > bricks.revision}

    def _bound(self, key: Key, raised: dict[Key, int]) -> int:
        """Return what no density of a brick passes, in units, as it is after all that was noted."""
        if key in raised:
            return raised[key]
        if key in self._raised:
            return self._raised[key][0]
        brick = self._bricks.get(key)
        return FIELD_UNITS + (max(-brick.low, brick.high) if brick else 0)

    def _largest(self, box: Box, raised: dict[Key, int]) -> int:
        return max(self._bound(key, raised) for key in keys_in(0, box))


def _raises(stroke: Stroke) -> int:
    """Return by how many units a stroke may raise the largest density."""
    match stroke:
        case Add(strength=strength):
            return math.ceil(abs(strength) * UNITS_PER_VOXEL)
        case Delta():
            return int(np.abs(stroke.deltas()).max())
        case Smooth() | Flatten():
            return ROUNDING_UNITS
    return 0
