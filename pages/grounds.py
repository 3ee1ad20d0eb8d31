"""What the ground is made of: a colour for each vertex from its slope, its height and its level.

Colours are linear, (V, 3) float64.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pages.speckle import noise

Vectors = NDArray[np.float64]
Colour = tuple[float, float, float]

LEVELS: Final = np.array(
    [
        *[(0.75, 0.20, 0.12), (0.80, 0.50, 0.10), (0.75, 0.70, 0.15), (0.25, 0.60, 0.20), (0.12, 0.55, 0.55)],
        *[(0.12, 0.30, 0.70), (0.40, 0.20, 0.65), (0.65, 0.20, 0.50), (0.45, 0.45, 0.45)],
    ]
)
"""A colour per LOD; coarser ones start again."""

TEXTURE_OCTAVES: Final = 8
TEXTURE_COARSEST: Final = 6.0
"""Size of the texture's largest grains, in voxels; each octave has half the size of the one before."""
TEXTURE: Final = 0.08
EMBOSS: Final = 0.20
"""How much a grain's own colour and its slope towards the sun change what is seen."""


class Ground(NamedTuple):
    """A kind of ground.

    low, high: what lies flat, below and above the heights of `change`. steep: where the slope is more than `slope`.
    hidden: under overhangs. radius: 0 on flat worlds; on a planet the height above it counts, and up is outwards.
    """

    low: Colour
    high: Colour
    steep: Colour
    hidden: Colour
    change: tuple[float, float] = (0.0, 12.0)
    slope: float = 0.72
    radius: float = 0.0

    def colours(self, points: Vectors, normals: Vectors) -> Vectors:
        """Return the colour of each vertex. points: (V, 3) in the world, voxels. normals: (V, 3), unit."""
        distance = np.linalg.norm(points, axis=1)
        upwards = points / distance[:, None] if self.radius else np.broadcast_to([0.0, 1.0, 0.0], points.shape)
        height = distance - self.radius if self.radius else points[:, 1]
        flatness = np.einsum("ij,ij->i", normals, upwards)
        patches = _patches(points)
        colour = _mixed(self.low, self.high, _smooth(height + 5 * patches, *self.change))
        colour = _mixed(self.steep, colour, _smooth(flatness + 0.08 * patches, self.slope - 0.10, self.slope + 0.10))
        colour = _mixed(self.hidden, colour, _smooth(flatness, -0.35, 0.10))
        return np.asarray(colour * (1 + 0.15 * patches)[:, None])


def _mixed(a: Colour | Vectors, b: Colour | Vectors, share: Vectors) -> Vectors:
    return np.asarray(a) * (1 - share)[:, None] + np.asarray(b) * share[:, None]


def _smooth(value: Vectors, low: float, high: float) -> Vectors:
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _patches(points: Vectors) -> Vectors:
    """Return about -1 to 1 per point, so that no meadow has one colour."""
    return 1.2 * noise(points / 61) + 0.8 * noise(points / 17)


def texture(points: Vectors, pixel: Vectors, to_sun: Vectors) -> Vectors:
    """Return a factor around 1 per pixel, (H, W, 1): stones and tufts finer than any vertex, lit from one side.

    points: (H, W, 3) what each pixel shows, in the world. pixel: (H, W) how wide it is there, in voxels. What would be
    finer than two pixels is left out.
    """
    relief = np.zeros(pixel.shape)
    for octave in range(TEXTURE_OCTAVES):
        size = TEXTURE_COARSEST / 2**octave
        shown = np.clip(size / (2 * pixel) - 1, 0, 1)
        turned = points / size + octave * 0.37
        relief += shown * (TEXTURE * noise(turned) + EMBOSS * (noise(turned) - noise(turned + 0.35 * to_sun)))
    return np.clip(1 + relief, 0.3, 1.7)[..., None]


GRASS: Final = Ground(
    low=(0.058, 0.092, 0.026), high=(0.135, 0.135, 0.050), steep=(0.190, 0.155, 0.120), hidden=(0.15, 0.12, 0.10)
)
ALPINE: Final = Ground(
    low=(0.052, 0.080, 0.028),
    high=(0.80, 0.82, 0.86),
    steep=(0.17, 0.15, 0.14),
    hidden=(0.12, 0.11, 0.10),
    change=(8, 22),
    slope=0.62,
)
ROCK: Final = Ground(
    low=(0.32, 0.23, 0.16), high=(0.38, 0.29, 0.21), steep=(0.27, 0.20, 0.15), hidden=(0.22, 0.16, 0.12)
)
RUST: Final = Ground(
    low=(0.19, 0.085, 0.040),
    high=(0.42, 0.30, 0.20),
    steep=(0.24, 0.13, 0.08),
    hidden=(0.15, 0.09, 0.06),
    change=(-16, 16),
)
