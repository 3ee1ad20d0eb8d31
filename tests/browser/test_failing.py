"""What the page says when something is missing, and how it goes on when it is there."""

from pathlib import Path

import numpy as np

from chunkserver.server import mint
from tests.browser.conftest import Play
from tests.browser.pictures import pixels
from tests.serving import Server, serving


def test_no_webgl(play: Play, server: Server):
    found = play("flat", server)
    assert "WebGL 2" in found["notice"]
    assert found["buttons"] == 0, "there are buttons that can do nothing"


def test_a_lost_picture_comes_back(play: Play, server: Server):
    found = play("context", server)
    assert "comes back" in found["notice"]
    before, after = map(pixels, found["pictures"])
    assert before.std() > 4
    assert np.array_equal(before, after)


def test_a_server_that_is_away_at_first(play: Play, server: Server):
    found = play("away", server)
    assert "away" in found["notice"]
    assert found["isAway"]
    assert found["isSame"]
    assert found["isHidden"]
    assert not found["after"]["isAway"]
    assert found["after"]["triangles"] > 0


def test_a_server_with_keys(play: Play, tmp_path: Path):
    made = {scope: mint(scope, scope) for scope in ("read", "admin")}
    kept = " ".join(str(row) for _, row in made.values())
    with serving(tmp_path / "log", "--workers", "1", "--api-keys", kept) as own:
        found = play("keys", own, keys=["not-a-key", made["read"][0], made["admin"][0]])
    assert "needs an API key" in found["asked"]
    assert "does not know" in found["refused"]
    assert found["shown"]["triangles"] > 0
    assert "admin" in found["told"]
    assert "read" in found["told"]
    assert found["kept"]["revision"] == "0"
    assert found["dug"]["revision"] == "1"
    assert found["dug"]["triangles"] != found["shown"]["triangles"]
    assert found["open"] == [False, False], "who has a key is still asked for one"
