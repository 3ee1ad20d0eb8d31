"""The built-in caves are noise, scaled so that their density is a distance near their surface."""

import numpy as np

from chunkserver.recipe.library.terrain import CAVE_FREQUENCY, CAVE_SCALE, CAVE_THRESHOLD
from tests.noises import evaluate
from tests.scale import count


def test_gradient_of_the_caves_is_about_one_per_voxel_at_their_surface(rng):
    """The mean over the surface, by area: CAVE_SCALE makes a stroke's strength mean voxels."""
    points = rng.uniform(-1e5, 1e5, (count(100_000_000), 3))
    near = np.abs(evaluate("simplex3", points, frequency=CAVE_FREQUENCY) - CAVE_THRESHOLD) < 0.02
    points = points[near]
    slopes = []
    for axis in range(3):
        side = np.eye(3)[axis] / 4
        above, below = (evaluate("simplex3", points + s, frequency=CAVE_FREQUENCY) for s in (side, -side))
        slopes.append(CAVE_SCALE * (above - below) / 0.5)
    gradient = np.sqrt(np.square(slopes).sum(0, dtype=np.float64))
    assert 0.95 < (gradient**2).sum() / gradient.sum() < 1.1
