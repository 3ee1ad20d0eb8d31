"""A picture's chunks fill the space around the eye, each place once, finer where a cell would be seen."""

import math
from itertools import pairwise

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from pages import scenes
from pages.scenes import SHAPE, Camera, Extent, cut

CAMERA = Camera((10.0, 20.0, -30.0), (100.0, 0.0, 50.0), width=320, height=180)
EXTENT = Extent(far=1000, cell_pixels=4)


def corners(key: ChunkKey) -> tuple[np.ndarray, np.ndarray]:
    low = np.array(key.low_corner(SHAPE.cells))
    return low, low + (SHAPE.cells << key.lod)


def test_every_place_within_reach_is_in_one_chunk(rng):
    keys = list(cut(CAMERA, EXTENT))
    low, high = (np.array(side) for side in zip(*map(corners, keys), strict=True))
    for _ in range(200):
        towards = rng.normal(size=3)
        place = np.array(CAMERA.eye) + towards / np.linalg.norm(towards) * rng.uniform(0, 1000)
        assert ((low <= place) & (place < high)).all(axis=1).sum() == 1


def test_cells_look_no_wider_than_wanted():
    ahead = CAMERA.axes()[2]
    keys = list(cut(CAMERA, EXTENT))
    for distance in (20, 80, 200, 400, 800):
        place = np.array(CAMERA.eye) + ahead * distance
        (key,) = [key for key in keys if all((corners(key)[0] <= place) & (place < corners(key)[1]))]
        assert key.lod == 0 or key.step <= 4 * CAMERA.pixel * distance


def test_what_is_behind_the_eye_is_coarser_and_levels_follow_one_another():
    keys = list(cut(CAMERA, EXTENT))
    ahead = CAMERA.axes()[2]
    behind = [key for key in keys if (np.mean(corners(key), axis=0) - CAMERA.eye) @ ahead < -150]
    before = [key for key in keys if (np.mean(corners(key), axis=0) - CAMERA.eye) @ ahead > 150]
    assert min(key.lod for key in behind) > min(key.lod for key in before)
    assert all(b - a == 1 for a, b in pairwise(sorted({key.lod for key in keys})))


def test_the_floor_hides_what_lies_under_it():
    flat, round_ = Extent(far=1, floor=-32), Extent(far=1, floor=-32, radius=100)
    assert flat.hides(ChunkKey(0, 0, -3, 0))
    assert not flat.hides(ChunkKey(0, 0, -2, 0))
    assert round_.hides(ChunkKey(0, 0, 0, 0))
    assert not round_.hides(ChunkKey(0, 0, 2, 0))


def test_what_is_hidden_or_out_of_reach_stays_in_large_chunks():
    reach, hidden = EXTENT._replace(far=300), EXTENT._replace(floor=2000)
    keys = list(cut(CAMERA, reach))
    distances = [np.linalg.norm(np.clip(CAMERA.eye, *corners(key)) - CAMERA.eye) for key in keys]
    assert {key.lod for key, distance in zip(keys, distances, strict=True) if distance > 600} <= {max(keys).lod}
    assert len(list(cut(CAMERA, hidden))) < len(list(cut(CAMERA, EXTENT))) / 10


def test_a_view_is_bounded(monkeypatch):
    monkeypatch.setattr(scenes, "CHUNKS_MAX", 100)
    with pytest.raises(ValueError, match="more than 100 chunks"):
        list(cut(CAMERA, EXTENT))


def test_axes_are_at_right_angles():
    axes = CAMERA.axes()
    assert axes @ axes.T == pytest.approx(np.eye(3))
    assert axes[1][1] > 0
    assert pytest.approx(2 * math.tan(math.radians(30))) == CAMERA.pixel * CAMERA.width
