"""What light there is: the sky's colour in every direction, the sun, the haze in between, and the film it falls on.

Colours are linear, (..., 3) float64, red green blue.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pages.speckle import hashed, noise

Colours = NDArray[np.float64]

ZENITH: Final = (0.08, 0.26, 0.80)
HORIZON: Final = (0.68, 0.86, 1.08)
GROUND: Final = (0.16, 0.15, 0.13)
NOON: Final = (3.4, 3.1, 2.7)
EVENING: Final = (3.4, 2.0, 0.9)
SUN_COSINE: Final = 0.9998
SUN_DEGREES: Final = 1.5
"""Half the width of the sun that throws shadows."""
FILL: Final = 1.5
"""How much brighter than it looks the sky is on the ground: film holds less contrast than eyes."""
CLOUD_SCALE: Final = 0.9
CLOUD_OCTAVES: Final = 5
STARS: Final = 0.0006
"""The share of directions of space that hold a star."""
STAR_CELLS: Final = 700
STARLIGHT: Final = 0.03
EXPOSURE: Final = 0.95
TOE: Final = 1.12


class Light(NamedTuple):
    """Where light comes from.

    azimuth, elevation: of the sun, degrees, in the axes of the world whatever is up for the camera: azimuth 0 is +x and
        90 is +z, elevation 90 is +y.
    haze: voxels after which two thirds of what is seen is haze; infinite for none.
    space: no air: a black sky with stars.
    """

    azimuth: float = 40.0
    elevation: float = 35.0
    haze: float = float("inf")
    space: bool = False

    def to_sun(self) -> Colours:
        """Return the unit vector to the sun, (3,)."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), np.sin(elevation), flat * np.sin(azimuth)])

    def sunshine(self, up: Colours) -> Colours:
        """Return the sun's light on a face turned to it, (3,): the lower it stands, the redder."""
        high = 1.0 if self.space else np.clip(self.to_sun() @ up / 0.5, 0, 1)
        return np.array(EVENING) * (1 - high) + np.array(NOON) * high

    def sky(self, towards: Colours, up: Colours) -> Colours:
        """Return the light from the directions `towards`, (..., 3) unit vectors."""
        if self.space:
            return _stars(towards)
        level = _raised(towards, up)
        return _clouded(self._air(level, up), level, up, self.sunshine(up)) + self._disc(towards, up)

    def ambient(self, towards: Colours, up: Colours, size: Colours) -> Colours:
        """Return the sky as a source of light, the sun in it wider than it is: shadows get soft edges.

        size: (...) the solid angle that each direction stands for.
        """
        sky = np.full(towards.shape, STARLIGHT) if self.space else self._air(towards, up)
        disc = towards @ self.to_sun() > np.cos(np.radians(SUN_DEGREES))
        return np.asarray(FILL * sky + disc[..., None] * np.pi * self.sunshine(up) / np.sum(size[disc]))

    def through_air(self, seen: Colours, distance: Colours, towards: Colours, up: Colours) -> Colours:
        """Return what is left of `seen`, (..., 3), at a distance in voxels, (...), and the air's own light."""
        left = np.exp(-((distance / self.haze) ** 1.5))[..., None]
        return np.asarray(left * seen + (1 - left) * self._air(_raised(towards, up), up))

    def _air(self, towards: Colours, up: Colours) -> Colours:
        """Return the light of air without clouds: brighter around the sun."""
        nearness = np.maximum(towards @ self.to_sun(), 0)[..., None]
        return _gradient(towards, up) + self.sunshine(up) * (0.05 * nearness**6 + 0.10 * nearness**48)

    def _disc(self, towards: Colours, up: Colours) -> Colours:
        """Return the light of the sun's disc and of its rim."""
        nearness = np.maximum(towards @ self.to_sun(), 0)[..., None]
        return np.asarray(self.sunshine(up) * (4.0 * (nearness > SUN_COSINE) + 0.25 * nearness**800))


def _raised(towards: Colours, up: Colours) -> Colours:
    """Return the directions, those below the horizon raised to it: haze has no other side."""
    level = towards - np.minimum(towards @ up, 0)[..., None] * up
    return np.asarray(level / np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9))


def _gradient(towards: Colours, up: Colours) -> Colours:
    """Return the sky's own gradient: pale at the horizon, deep above, the ground's shade below."""
    height = (towards @ up)[..., None]
    pale = (1 - np.clip(height, 0, 1)) ** 3.5
    above = np.array(ZENITH) * (1 - pale) + np.array(HORIZON) * pale
    below = np.clip(-height * 8, 0, 1)
    return above * (1 - below) + np.array(GROUND) * below


def _clouded(sky: Colours, towards: Colours, up: Colours, sunshine: Colours) -> Colours:
    """Return the sky with clouds in a plane above, thinner towards the horizon, where they would repeat too finely."""
    height = np.maximum(towards @ up, 0.02)[..., None]
    place = towards / height * CLOUD_SCALE
    thick = sum(noise(place * 2**octave + octave) / 2**octave for octave in range(CLOUD_OCTAVES))
    cover = np.clip((thick + 0.05) / 0.6, 0, 1) * np.clip((height[..., 0] - 0.02) / 0.16, 0, 1)
    white = 0.36 * sunshine + 0.15
    return np.asarray(sky + 0.85 * cover[..., None] * (white - sky))


def _stars(towards: Colours) -> Colours:
    """Return points of light at places without pattern, the same in every picture."""
    chance = hashed(np.floor(towards * STAR_CELLS).astype(np.int64)) / 2 + 0.5
    bright = np.where(chance < STARS, 0.15 + 0.85 * (chance / STARS) ** 4, 0.0)
    return np.repeat(bright[..., None], 3, axis=-1)


def film(light: Colours) -> NDArray[np.uint8]:
    """Return pixels, (..., 3) uint8 sRGB: a soft shoulder for highlights, a slight toe for contrast."""
    exposed = 1 - np.exp(-EXPOSURE * np.maximum(light, 0))
    toned = exposed**TOE
    encoded = np.where(toned <= 0.0031308, 12.92 * toned, 1.055 * np.maximum(toned, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * np.clip(encoded, 0, 1)).astype(np.uint8)
