"""Tiny pictures show what they should: the ball where it is, lit from the sun's side, sky around it."""

import numpy as np
import pytest

from chunkserver.recipe import WorldRecipe, canonical
from pages.grounds import LEVELS, ROCK
from pages.light import Light, film
from pages.renderer import Image, Look, render
from pages.scenes import Camera, Extent, build

RADIUS = 40.0
DISTANCE = 200.0
CAMERA = Camera((0.0, 0.0, DISTANCE), (0.0, 0.0, 0.0), width=64, height=36)
FROM_THE_RIGHT = Light(azimuth=0, elevation=0, space=True)
SCENE = build(WorldRecipe(0, canonical({"builtin": "sphere", "radius": RADIUS})), CAMERA, Extent(far=300))


def picture(look: Look = "ground", light: Light = FROM_THE_RIGHT) -> Image:
    return render(SCENE, CAMERA, light, ROCK, look, rays=4)


def test_a_ball_has_its_size_and_its_place():
    image = picture("normals")
    ball = (image != 128).any(axis=2)
    rows, columns = np.nonzero(ball)
    assert rows.mean() == pytest.approx(17.5, abs=0.3)
    assert columns.mean() == pytest.approx(31.5, abs=0.3)
    seen_radius = RADIUS / np.sqrt(DISTANCE**2 - RADIUS**2) / CAMERA.pixel
    assert np.sqrt(ball.sum() / np.pi) == pytest.approx(seen_radius, rel=0.06)


def test_normals_show_their_axes():
    image = picture("normals").astype(float)
    middle, right, top = image[17:19, 31:33].mean(axis=(0, 1)), image[18, 41], image[8, 32]
    assert middle == pytest.approx([128, 128, 255], abs=8)
    assert right[0] > 220
    assert top[1] > 220


def test_the_sun_lights_its_own_side_alone():
    image = picture().astype(float)
    left, right = image[14:22, 22:26].mean(), image[14:22, 38:42].mean()
    assert right > 90
    assert left < right / 3


def test_the_sky_lights_what_the_sun_does_not():
    in_space, in_air = (picture(light=light).astype(float)[14:22, 22:26].mean() for light in (FROM_THE_RIGHT, DAY))
    assert in_air > 1.5 * in_space


DAY = Light(azimuth=0, elevation=5)


def test_a_level_has_its_colour_and_lines():
    image = picture("levels").astype(float)
    red, green, blue = image[14:22, 36:42].mean(axis=(0, 1))
    lod = min(key.lod for key, _ in SCENE)  # those of the side that the eye sees
    assert np.argsort([red, green, blue]).tolist() == np.argsort(LEVELS[lod]).tolist()


def test_far_things_are_haze():
    near, far = (picture(light=DAY._replace(haze=haze)).astype(float) for haze in (1e6, 20.0))
    sky = far[16:20, 2:6].mean(axis=(0, 1))
    assert np.abs(far[16:20, 30:34].mean(axis=(0, 1)) - sky).max() < 12
    assert np.abs(near[16:20, 30:34].mean(axis=(0, 1)) - sky).max() > 30


def test_no_chunks_are_a_picture_of_the_sky():
    image = render([], CAMERA, Light(), ROCK, rays=1)
    assert image.shape == (36, 64, 3)
    assert image.dtype == np.uint8
    assert image[0, :, 2].mean() > image[0, :, 0].mean()


def test_film_keeps_the_order_of_lights():
    pixels = film(np.linspace(0, 8, 200)[:, None] * np.ones(3))
    assert pixels[0].tolist() == [0, 0, 0]
    assert pixels[-1].min() >= 250
    assert (np.diff(pixels.astype(int), axis=0) >= 0).all()
