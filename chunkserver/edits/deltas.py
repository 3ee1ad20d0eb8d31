"""What edits make of one chunk: which bricks its samples read, and what becomes of these."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits.bricks import Bricks
from chunkserver.edits.reading import Reading, apply
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.samples import Samples, coarse_box


class Deltas(NamedTuple):
    """The deltas of one chunk's samples. Without the arena they are cheap to send to another process.

    own: of the chunk's level. coarse: of the next level, where the chunk's mask takes that; or None.
    """

    own: Reading
    coarse: Reading | None

    @classmethod
    def of(cls, bricks: Bricks, key: ChunkKey, shape: ChunkShape, coarser: int = 0) -> "Deltas":
        """Return the deltas of chunk `key`, as `bricks` have them: keep these until they have been read.

        coarser: mask of the faces whose neighbour is one level coarser.
        """
        side, cells = shape.samples, shape.cells
        x, y, z = (cells * at - shape.apron for at in key[1:])
        own = bricks.read(key.lod, (x, y, z), (side, side, side))
        if not coarser:
            return cls(own, None)
        box = coarse_box(cells, coarser)
        x, y, z = (cells // 2 * at + first for at, first in zip(key[1:], box.low, strict=True))
        return cls(own, bricks.read(key.lod + 1, (x, y, z), box.shape))

    @property
    def range(self) -> tuple[int, int]:
        """What they all lie between, 0 included, units."""
        readings = self.own, self.coarse or self.own
        return min(reading.low for reading in readings), max(reading.high for reading in readings)

    def add_to(self, samples: Samples, arena: NDArray[np.int32]) -> None:
        """Change the samples of the chunk, which all have to be worked out, from pristine to edited.

        arena: where the bricks lie.
        """
        apply(samples.density, arena, self.own)
        if samples.coarse is not None and self.coarse is not None:
            apply(samples.coarse, arena, self.coarse)
