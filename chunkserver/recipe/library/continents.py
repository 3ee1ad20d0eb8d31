"""Continents: a planet whose sea, if there were any, would stand at its radius. One noise says how high land is, and so
where its coasts, mountains and caves can be."""

from typing import Final

from chunkserver.recipe.builder import fbm3, minimum, remap, ridged3, simplex3, smooth_max, sphere
from chunkserver.recipe.library.fading import at_once
from chunkserver.recipe.library.parameters import LargeSize, Size
from chunkserver.recipe.node import Node

CONTINENTS_RADIUS: Final = 10_000.0
CONTINENTS_RELIEF: Final = 480.0
LAND: Final = ((-0.46, -0.5), (-0.16, -0.34), (-0.05, -0.06), (0.025, -0.012), (0.04, 0.004), (0.24, 0.12), (0.6, 0.28))
"""Height over the continents' noise, in reliefs: ocean floor, shelf, shore, plains, highlands."""
HILLS: Final = ((-0.16, 10.0), (0.01, 3.0), (0.05, 5.0), (0.16, 22.0))
"""Height of the hills over the same noise, voxels: low at the shores, so that these stay where the land ends."""
INLAND: Final = ((0.03, 0.0), (0.2, 1.0))
CHAINS: Final = ((0.5, 0.0), (0.84, 1.0))
"""Where mountains are: inland, and where the folds of a noise are. The share of their height over each noise."""
MOUNTAIN: Final = 0.3
"""Width of the largest folds of a mountain, in lattice cells a relief."""
CAVE_FREQUENCY: Final = 0.022
CAVE: Final = ((0.0, -4000.0), (0.42, -2.4), (0.6, 0.0), (1.0, 5.2))
"""Density over the caves' noise. Its mean is deep in rock: faded caves do not bend the ground."""
CAVES_DEEP: Final = 56.0
"""How far caves go below the ground, voxels."""
CAVES_INLAND: Final = 0.09
CAVES_RISE: Final = 2000.0
"""Caves are where the land's noise is above the first; the second makes voxels of it. So no sea stands in them."""
CUT_RADIUS: Final = 7.0


def continents(radius: LargeSize = CONTINENTS_RADIUS, relief: Size = CONTINENTS_RELIEF) -> Node:
    """A planet of continents and ocean floors, with mountain chains, hills and caves."""
    land = fbm3(frequency=1 / radius, octaves=7, gain=0.53, salt=1)
    chains = remap(ridged3(frequency=1.7 / radius, octaves=2, salt=2), points=CHAINS)
    mountains = ridged3(frequency=MOUNTAIN / relief, octaves=5, lacunarity=2.1, gain=0.47, salt=3) * 0.42 + 0.4
    hills = fbm3(frequency=0.0056, octaves=5, gain=0.47, salt=4) * remap(land, points=HILLS)
    inland = remap(fbm3(frequency=1 / radius, octaves=3, gain=0.53, salt=1), points=INLAND)
    high = inland * chains * mountains
    height = (remap(land, points=LAND) + high) * relief + hills
    surface = sphere(radius=radius) - height
    caves = remap(simplex3(frequency=CAVE_FREQUENCY, salt=5), points=CAVE)
    caves = at_once(caves, size=1 / CAVE_FREQUENCY, share=0.5)
    return smooth_max(
        surface, minimum(caves, surface + CAVES_DEEP, (land - CAVES_INLAND) * CAVES_RISE), radius=CUT_RADIUS
    )
