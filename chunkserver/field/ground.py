"""The field of LOD 0 over boxes, before any edit: what edits are worked out from."""

import numpy as np
from numpy.typing import NDArray

from chunkserver.field.flatten import flatten
from chunkserver.field.intervals import ALL_FINITE, bounds
from chunkserver.field.points import run_box
from chunkserver.recipe import WorldRecipe

Place = tuple[int, int, int]


class Ground:
    """A recipe's world at LOD 0. Safe in any thread. Raises `BadRecipe` as `field.sample` does."""

    def __init__(self, recipe: WorldRecipe) -> None:
        self._flat = flatten(recipe, 0)

    def sample(self, low: Place, shape: tuple[int, int, int]) -> NDArray[np.float32]:
        """Return the densities of a box of lattice points, to the bit those of `field.sample`.

        low: x, y, z of the first, voxels. shape: how many, (y, z, x).

        Returns (y, z, x) float32, C order, voxels, negative = rock, else air.
        """
        return run_box(self._flat.tape, np.array(low, float), 1.0, shape)

    def bound(
        self, low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what the densities of n boxes lie between: lowest and highest, (n,) float64; infinite if not known.

        low, high: (3, n) float64, corners x, y, z, voxels.
        """
        found, result = bounds(self._flat.kept, low, high), self._flat.kept.result
        known = found.failed == ALL_FINITE
        lowest = np.where(known, found.low[result], -np.inf).astype(np.float64)
        return lowest, np.where(known, found.high[result], np.inf).astype(np.float64)
