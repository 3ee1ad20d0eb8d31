"""Tiny pictures of meshes show what they should: where the surface is, its light, its lines, and what they hide."""

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, canonical
from pages.grounds import ROCK
from pages.light import Light
from pages.meshes import View, chunks, draw, raster
from pages.meshes.chunks import box, rings, served
from pages.scenes import Camera

Recipe = dict[str, object]

BALL: Recipe = {"builtin": "sphere", "radius": 20}
FROM_THE_RIGHT = Light(azimuth=0, elevation=10)
ASIDE = Camera((0.0, 0.0, 120.0), (0.0, 0.0, 0.0), width=64, height=40)
ABOVE = Camera((32.0, 80.0, 16.0), (32.0, 0.0, 16.0), up=(0.0, 0.0, -1.0), width=96, height=60)
PLANE = View("plane", box(0, (0, -1, 0), (2, 1, 1)), ABOVE, ROCK)
SEEN = View(BALL, box(0, (-1, -1, -1), (1, 1, 1)), ASIDE, ROCK, FROM_THE_RIGHT)
EMPTY_KEYS = box(0, (9, 9, 9), (10, 10, 10))


Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


def picture(view: View) -> Ints:
    return draw(view).astype(np.int64)


def changed(a: Ints, b: Ints) -> Mask:
    return np.asarray((np.abs(a - b) > 12).any(axis=2))


def backdrop(view: View) -> Ints:
    """Return the picture without any surface in sight: a camera that looks away."""
    eye, target = np.array(view.camera.eye), np.array(view.camera.target)
    return picture(view._replace(camera=view.camera._replace(target=tuple(2 * eye - target))))


def red(image: Ints) -> Mask:
    return np.asarray((image[..., 0] > 150) & (image[..., 1:].max(axis=2) < 110))


def test_the_surface_is_where_it_should_be_and_the_backdrop_around_it():
    ball = changed(picture(SEEN), backdrop(SEEN))
    rows, columns = np.nonzero(ball)
    assert (rows.mean(), columns.mean()) == pytest.approx((19.5, 31.5), abs=0.5)
    radius = 20 / np.sqrt(120**2 - 20**2) / ASIDE.pixel
    assert np.sqrt(ball.sum() / np.pi) == pytest.approx(radius, rel=0.08)


def test_the_same_view_is_the_same_picture():
    assert (picture(SEEN) == picture(SEEN)).all()


def test_the_sun_lights_its_own_side():
    image = picture(SEEN)
    left, right = image[16:24, 25:28].mean(), image[16:24, 36:39].mean()
    assert right > 1.5 * left > 30


def test_what_stands_in_the_sun_throws_a_shadow():
    floating: Recipe = {"op": "min", "a": {"op": "y"}, "b": {"op": "sphere", "center": [48, 10, 16], "radius": 4}}
    low_sun = Light(azimuth=0, elevation=30)
    image = picture(PLANE._replace(recipe=floating, light=low_sun))
    west, east = (image[28:32, round(48 + (x - 32) / 80 / ABOVE.pixel)].mean() for x in (31, 62))
    assert east > 1.5 * west


def test_normals_are_red_green_blue():
    image = picture(SEEN._replace(tint="normals"))
    assert image[19:21, 31:33].mean(axis=(0, 1)) == pytest.approx([128, 128, 255], abs=12)
    assert image[20, 39, 0] > 200


def test_flat_triangles_have_one_normal_each():
    coarse = View(
        {"builtin": "sphere", "radius": 200},
        box(5, (-1, -1, -1), (1, 1, 1)),
        ASIDE._replace(eye=(0, 0, 1000)),
        "normals",
    )
    smooth, flat = (picture(coarse._replace(flat=flat)) for flat in (False, True))
    same = [(np.abs(np.diff(image[14:26, 26:38], axis=1)).max(axis=2) <= 1).mean() for image in (smooth, flat)]
    assert same[1] > same[0] + 0.3


def test_wireframe_is_on_the_surface_alone():
    camera = Camera((0.0, 0.0, 480.0), (0.0, 0.0, 0.0), width=128, height=80)
    view = View({"builtin": "sphere", "radius": 160}, box(4, (-1, -1, -1), (1, 1, 1)), camera, ROCK)
    shaded, wired = picture(view), picture(view._replace(lines=("triangles",)))
    ball = changed(shaded, backdrop(view))
    assert changed(wired, shaded)[ball].mean() > 0.3
    assert not changed(wired, shaded)[~ball].any()


def test_the_chunk_in_focus_alone_is_wired():
    near = PLANE._replace(camera=ABOVE._replace(eye=(32.0, 20.0, 16.0)))
    focus = next(mesh.key for mesh in served(WorldRecipe(0, canonical("plane")), near.keys) if mesh.key.x == 1)
    wired = near._replace(lines=("triangles",), focus=ChunkKey(*focus))
    lines = changed(picture(wired), picture(near))
    assert lines[:, 50:].mean() > 0.3
    assert not lines[:, :46].any()


def test_open_edges_are_red_around_the_chunks_and_not_between_them():
    image = picture(PLANE._replace(lines=("rims",)))
    rim = red(image)
    across, down = 32 / 80 / ABOVE.pixel, 16 / 80 / ABOVE.pixel
    for column in (48 - across, 48 + across):
        assert rim[20:40, round(column - 2) : round(column + 2)].any(axis=1).all()
    for row in (30 - down, 30 + down):
        assert rim[round(row - 2) : round(row + 2), 25:70].any(axis=0).all()
    assert not rim[20:40, 30:66].any()


def test_levels_that_do_not_fit_are_open_where_they_meet():
    hills: Recipe = {"builtin": "hills", "relief": 20}
    keys = box(0, (0, -1, 0), (2, 1, 2)) + box(1, (1, -1, 0), (2, 1, 1))
    camera = ABOVE._replace(eye=(64.0, 150.0, 32.0), target=(64.0, 0.0, 32.0))
    assert (
        red(picture(View(hills, box(0, (0, -1, 0), (2, 1, 1)), ABOVE, "lods", lines=("rims",))))[24:36, 40:56].sum()
        == 0
    )
    open_edges, skirts, closed = (
        red(picture(View(hills, keys, camera, "lods", lines=("rims",), seam=seam)))[22:38, 46:50].any(axis=1).mean()
        for seam in ("none", "skirts", "transitions")
    )
    assert (open_edges, closed) == (1, 0)
    assert skirts > 0


def test_borders_are_drawn_where_chunks_meet():
    border = changed(picture(PLANE._replace(lines=("borders",))), picture(PLANE))
    assert border[20:40, 46:50].any(axis=1).all()
    assert not border[20:40, 30:44].any()


def test_lines_behind_the_surface_are_hidden():
    """Also if there are chunks behind the camera: depths are no coarser for them."""
    behind: Recipe = {"op": "min", "a": {"op": "y"}, "b": {"op": "sphere", "center": [256, 900, 128], "radius": 72}}
    bubble: Recipe = {"op": "sphere", "center": [256, -92, 128], "radius": 72}
    hollow: Recipe = {"op": "max", "a": behind, "b": {"op": "multiply", "a": bubble, "b": -1}}
    far = ABOVE._replace(eye=(256.0, 640.0, 128.0), target=(256.0, 0.0, 128.0), across=20.0)
    view = PLANE._replace(camera=far, keys=box(3, (0, -1, 0), (2, 4, 1)))
    wired = [view._replace(recipe=recipe, lines=("triangles",)) for recipe in (behind, hollow)]
    plain, above = (changed(picture(view), picture(view._replace(lines=()))) for view in wired)
    assert plain.mean() > 0.1
    assert (plain ^ above).mean() < 0.03


def test_distances_are_exact_far_away_with_something_behind_the_camera():
    far = 2000.0
    points = np.array([[-far, -far, -far], [far, -far, -far], [0, far, -far], [0, 0, 9], [1, 0, 9], [0, 1, 9]])
    camera = Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), width=16, height=10)
    with raster.Stage(16, 10, np.zeros(3), points, np.arange(6).reshape(2, 3)) as stage:
        stage.look(camera)
        assert stage.distance_seen()[5, 8] == pytest.approx(far, abs=0.02)


def test_the_rocks_side_has_a_colour_of_its_own():
    below = ABOVE._replace(eye=(32.0, -80.0, 16.0))
    above, under = (picture(PLANE._replace(camera=camera))[30, 48] for camera in (ABOVE, below))
    assert above[0] > above[2]
    assert under[0] < under[2]


def test_levels_have_their_colours():
    colours = []
    for lod in range(2):
        keys = box(lod, (0, -1, 0), (2 >> lod, 1, 1))
        colours.append(picture(PLANE._replace(keys=keys, tint="lods"))[34, 40])
    assert colours[0][0] > colours[0][1]
    assert colours[1][1] > colours[1][0]


def test_nothing_to_draw_is_refused():
    with pytest.raises(ValueError, match="no chunk of the picture has a surface"):
        draw(PLANE._replace(keys=EMPTY_KEYS))


def test_pictures_are_bounded(monkeypatch):
    monkeypatch.setattr(chunks, "CHUNKS_MAX", 3)
    with pytest.raises(ValueError, match="4 chunks: a picture has at most 3"):
        draw(PLANE)


def test_a_system_without_opengl_is_told_what_is_missing(monkeypatch):
    monkeypatch.setattr(raster, "EGL", "libnowhere.so.9")
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(RuntimeError, match=r"no libnowhere\.so\.9.*libegl1"):
        draw(PLANE)


def test_rings_cover_each_place_once():
    keys = rings((0, 1, 2), 4, -40, 70)
    lows = {lod: {key.y for key in keys if key.lod == lod} for lod in range(3)}
    assert lows == {0: {-2, -1, 0, 1, 2}, 1: {-1, 0, 1}, 2: {-1, 0}}
    for x, z in ((0, 0), (-128, 127), (128, 0), (-300, 5), (511, -512)):
        covering = [key for key in keys if key.x == x // (32 << key.lod) and key.z == z // (32 << key.lod)]
        assert len({key.lod for key in covering}) == 1
