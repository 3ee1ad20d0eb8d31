"""The viewer in Chromium against the real server: what people do with it, and what they see."""

import base64
import io
import json
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from PIL import Image

from tests.serving import Server, serving

DRIVER: Final = Path(__file__).with_name("drive.mjs")
STOP_SECONDS_MAX: Final = 30.0
BACKGROUND: Final = (17, 22, 29)
"""Of every view but the shaded one: clients/viewer/src/look/views.ts."""
BACKGROUND_NEAR: Final = 12
WORLD: Final = "viewer-planet-42"

Play = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("server") / "log", "--workers", "1") as running:
        yield running


@pytest.fixture(scope="module")
def play(tmp_path_factory) -> Iterator[Play]:
    """Plays a scene of drive.mjs and returns what it has found. keeps: its pages stay open for the next scene."""
    driver = subprocess.Popen(
        ["node", DRIVER], cwd=DRIVER.parents[1], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert driver.stdin is not None
    assert driver.stdout is not None
    folder = str(tmp_path_factory.mktemp("chromium"))
    stdin, stdout = driver.stdin, driver.stdout

    def played(scene: str, server: Server, keeps: bool = False) -> dict[str, Any]:
        stdin.write(json.dumps({"scene": scene, "url": server.url, "folder": folder, "keeps": keeps}) + "\n")
        stdin.flush()
        answer = json.loads(stdout.readline())
        assert "found" in answer, answer["error"]
        found: dict[str, Any] = answer["found"]
        return found

    try:
        yield played
        stdin.close()
        stdout.read()
        stdout.close()
        assert driver.wait(STOP_SECONDS_MAX) == 0
    finally:
        driver.kill()
        driver.wait()


def _pixels(picture: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB"))


def test_a_planet_in_three_levels_and_four_views(play: Play, server: Server):
    found = play("levels", server)
    assert sum(count > 0 for count in found["levels"]) >= 3
    assert found["triangles"] > 10_000
    assert found["pending"] == 0
    assert found["title"].startswith("Planet, seed 42")
    pictures = [_pixels(view) for view in found["views"].values()]
    for number, picture in enumerate(pictures):
        assert picture[80:240].std() > 4, f"view {number} is blank"
        others = pictures[:number]
        assert all(np.abs(picture[80:240].astype(int) - other[80:240]).mean() > 3 for other in others), number


def test_no_background_through_a_seam(play: Play, server: Server):
    found = play("seams", server)
    assert len(found["levels"]) >= 3
    for number, picture in enumerate(map(_pixels, found["pictures"])):
        away = np.abs(picture.astype(int) - BACKGROUND).max(axis=-1)
        assert np.count_nonzero(away < BACKGROUND_NEAR) == 0, f"picture {number}"
        assert picture.std() > 4, f"picture {number} is blank"


def test_what_one_digs_another_one_sees(play: Play, tmp_path: Path):
    with serving(tmp_path / "log", "--workers", "1") as own:
        found = play("dig", own)
    one, other = found["counters"]
    assert found["before"]["counters"]["world"] == "seed"
    assert one["world"] == other["world"] == WORLD
    assert one["triangles"] == other["triangles"]
    assert one["levels"] == other["levels"]
    assert found["sight"][0] == pytest.approx(found["sight"][1], rel=1e-9)
    assert found["sight"][1] > found["before"]["sight"] + 3


def test_a_server_that_comes_back(play: Play, tmp_path: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    options = ("--workers", "1", "--port", port, "--data", str(tmp_path / "data"))
    with serving(tmp_path / "log", *options) as first:
        play("dig", first, keeps=True)
    lost = play("lost", first, keeps=True)
    assert "away" in lost["notice"]
    assert lost["counters"]["triangles"] > 0
    with serving(tmp_path / "again", *options) as second:
        found = play("back", second)
    assert found["before"]["world"] == WORLD
    assert int(found["after"]["revision"]) == int(found["before"]["revision"]) + 1 == 2
    assert found["isHidden"]


def test_a_link_restores_world_and_camera(play: Play, server: Server):
    found = play("link", server)
    first, second = found["cameras"]
    assert first["position"] == second["position"] == [1000000123.25, 90.5, -2000000.75]
    assert first["ahead"] == pytest.approx(second["ahead"], abs=1e-3)
    assert found["title"].startswith("Hills, seed -7")
    assert found["counters"]["triangles"] > 0


def test_the_keyboard_alone(play: Play, server: Server):
    found = play("keyboard", server)
    assert 1 < found["altitude"] < 2
    assert found["view"] == "levels"
    assert found["helps"]
    assert found["closed"]


def test_fingers(play: Play, server: Server):
    found = play("touch", server)
    assert found["moved"] > 2
    assert found["turned"] > 0.1


def test_a_recipe_is_edited(play: Play, server: Server):
    found = play("recipe", server)
    assert found["error"].startswith("Line 4. b")
    assert found["isInvalid"] == "true"
    assert found["after"] == ""
    assert "recipe=plane" not in found["hash"]
