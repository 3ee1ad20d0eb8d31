"""Overflow is refused before it is written: bounds of densities, brick by brick, of edits that are not folded yet.

Carve, fill, flatten and smooth make no density that is not between those around it, the field's limit and a distance:
they never raise the largest. So what counts is by how much `add` and `delta` can.
"""

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.arena import BRICK_BITS
from chunkserver.edits.bricks import Bricks
from chunkserver.edits.brushes import ADD, DELTA, FILL, FLATTEN, SMOOTH, STRENGTH
from chunkserver.edits.cubes import met
from chunkserver.edits.edit import Edit
from chunkserver.edits.keys import Key
from chunkserver.edits.strokes import DELTA_MAX, FIELD_MAX, UNITS_PER_VOXEL, Delta
from chunkserver.errors import BadStroke

_LOD: Final = np.zeros(1, np.int64)
_BESIDE: Final = np.array([[-1], [1]])
_Ints = NDArray[np.int64]

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
        ops = edit.brushes.ops.tolist()
        if max(ops) <= FILL or not any(raises := _raises(edit)):
            return
        raised: dict[Key, int] = {}
        cubes = met(np.zeros(len(raises), np.int64), edit.brushes.boxes, BRICK_BITS)
        keys, grids = cubes.places(), cubes.grids.tolist()
        boxes = edit.brushes.boxes
        for number, (first, last) in enumerate(pairwise([*cubes.starts.tolist(), len(grids)])):
            if by := raises[number]:
                around = self._around(boxes[number], raised) if ops[number] == SMOOTH else 0
                for brick in grids[first:last]:
                    key = keys[brick]
                    bound = raised[key] = max(self._bound(key, raised), around) + by
                    if bound + FIELD_UNITS > DELTA_MAX:
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

    def _around(self, box: _Ints, raised: dict[Key, int]) -> int:
        """Return what no density in a box, or a point beside it, passes."""
        around = met(_LOD, box[None] + _BESIDE, BRICK_BITS)
        return max(self._bound(key, raised) for key in around.places())


def _raises(edit: Edit) -> list[int]:
    """Return by how many units each stroke may raise the largest density."""
    of = edit.brushes
    units = np.where(of.ops == ADD, np.ceil(np.abs(of.numbers[:, STRENGTH]) * UNITS_PER_VOXEL), 0.0)
    units[(of.ops == SMOOTH) | (of.ops == FLATTEN)] = ROUNDING_UNITS
    raises: list[int] = units.astype(np.int64).tolist()
    for number in np.flatnonzero(of.ops == DELTA).tolist():
        stroke = edit.strokes[number]
        assert isinstance(stroke, Delta)
        raises[number] = int(np.abs(stroke.deltas()).max())
    return raises
