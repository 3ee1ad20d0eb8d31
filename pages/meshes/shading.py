"""Light on what is seen: each lamp is a direction that light comes from, and lights what it can see.

The sun is a handful of lamps close together, so that shadows have soft edges; the sky is a dome of lamps, so that what
lies deep is dark. What a lamp sees is drawn once more from its side.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pages.light import Light
from pages.meshes.raster import Stage

Vectors = NDArray[np.float64]
Plane = NDArray[np.float32]

SUN_LAMPS: Final = 5
SUN_SPREAD: Final = 0.018
"""Radians from the middle of the sun to its lamps."""
SKY_LAMPS: Final = 20
SKY_LOWEST: Final = -0.15
"""Height of the dome's rim: a little light comes from under the horizon."""
SKY: Final = (0.52, 0.66, 0.90)
RIM: Final = (0.60, 0.56, 0.50)
"""Light of the whole sky on level ground, from above and at the rim."""
EVERYWHERE: Final = (0.035, 0.033, 0.032)
"""What is left of light where no lamp reaches."""
TEXELS_AWAY: Final = 2.0
"""How far a place is moved off the ground before it is looked up in what a lamp sees: it shall not hide itself."""
BLUR_TEXELS: Final = 2.0
"""Width of the square in which a place is looked up, each pixel's elsewhere: the steps of shadows become fine grain."""
GOLDEN_ANGLE: Final = np.pi * (3 - 5**0.5)


class Lamp(NamedTuple):
    """A direction, (3,) unit, towards the light, and the light on a face turned to it, (3,)."""

    towards: Vectors
    colour: Vectors


def lamps(light: Light, up: Vectors) -> Iterator[Lamp]:
    """Yield the lamps of sun and sky."""
    right, above, towards = _axes(light.to_sun())
    sunshine = light.sunshine(up)
    for i in range(SUN_LAMPS):
        angle, reach = GOLDEN_ANGLE * i, SUN_SPREAD * np.sqrt((i + 0.5) / SUN_LAMPS)
        off = reach * (np.cos(angle) * right + np.sin(angle) * above)
        yield Lamp(_unit(towards + off), sunshine / SUN_LAMPS)
    if light.space:
        return
    right, ahead, above = _axes(up)
    heights = 1 - (np.arange(SKY_LAMPS) + 0.5) / SKY_LAMPS * (1 - SKY_LOWEST)
    share = 2.0 / SKY_LAMPS
    for i, height in enumerate(heights):
        flat = np.sqrt(1 - height**2)
        level = np.cos(GOLDEN_ANGLE * i) * right + np.sin(GOLDEN_ANGLE * i) * ahead
        colour = np.array(RIM) + (np.array(SKY) - RIM) * max(height, 0.0) ** 0.5
        yield Lamp(flat * level + height * above, colour * share)


def lit(stage: Stage, points: Plane, normals: Plane, to_eye: Plane, light: Light, up: Vectors, radius: float) -> Plane:
    """Return the light on the points, (M, 3) linear.

    points: (M, 3) voxels from the stage's centre. normals: (M, 3), unit, to the side that is seen. up: (3,) unit.
    to_eye: (M, 3), unit: where a face stands steeper than its normals say, that is the way off the ground.
    radius: voxels, of the ball around the centre that holds all that throws shadows.
    """
    texel = 2 * radius / stage.height
    lifted = np.ascontiguousarray((points + np.float32(TEXELS_AWAY * texel) * (normals + to_eye)).T)
    upright = np.ascontiguousarray(normals.T)
    total = np.repeat(np.array(EVERYWHERE, np.float32)[:, None], len(points), axis=1)
    grain = np.random.default_rng(0).random((2, len(points)), np.float32) - np.float32(0.5)
    for lamp in lamps(light, up):
        axes = _axes(-lamp.towards)
        stage.look_along(axes, radius)
        nearest = stage.distance_seen()
        facing = np.maximum(lamp.towards.astype(np.float32) @ upright, 0)
        facing *= _sees(nearest, axes, radius, lifted, BLUR_TEXELS * grain)
        grain = np.roll(grain, 1, axis=1)
        total += lamp.colour.astype(np.float32)[:, None] * facing
    return total.T


def _sees(nearest: Plane, axes: Vectors, radius: float, points: Plane, off: Plane) -> NDArray[np.bool_]:
    """Return whether a lamp sees the points, (3, M): nothing of `nearest`, what the lamp sees, is in front of them.

    off: (2, M) texels beside each point where it is looked up.
    """
    height, width = nearest.shape
    texel = 2 * radius / height
    x, y, ahead = axes.astype(np.float32) @ points
    columns = np.clip(x / texel + width / 2 + off[0], 0, width - 1).astype(np.int32)
    rows = np.clip(height / 2 - y / texel + off[1], 0, height - 1).astype(np.int32)
    return np.asarray(ahead + 2 * radius < nearest.reshape(-1)[rows * width + columns])


def _axes(ahead: Vectors) -> Vectors:
    """Return (3, 3): unit vectors to the right, up and ahead, at right angles."""
    aside = np.eye(3)[np.argmin(np.abs(ahead))]
    right = _unit(np.cross(ahead, aside))
    return np.stack([right, np.cross(right, ahead), _unit(ahead)])


def _unit(vector: Vectors) -> Vectors:
    return np.asarray(vector / np.linalg.norm(vector))
