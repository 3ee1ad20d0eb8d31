"""Several who dig in one world, and a server that goes away."""

import socket
from pathlib import Path
from typing import Final

import httpx2
import pytest

from tests.browser.conftest import Play
from tests.serving import serving

WORLD: Final = "viewer-planet-42"


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


def test_two_dig_at_once(play: Play, tmp_path: Path):
    with serving(tmp_path / "log", "--workers", "1") as own:
        found = play("both", own)
    one, *others = found["counters"]
    assert one["revision"] == "5"
    for other in others:
        assert [other[name] for name in ("revision", "triangles", "chunks", "levels", "world")] == [
            one[name] for name in ("revision", "triangles", "chunks", "levels", "world")
        ]
    assert found["sight"] == pytest.approx([found["sight"][0]] * 3, rel=1e-9)


def test_a_server_that_comes_back_with_an_edit_of_somebody_else(play: Play, tmp_path: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    options = ("--workers", "1", "--port", port, "--data", str(tmp_path / "data"))
    with serving(tmp_path / "log", *options) as first:
        play("dig", first, keeps=True)
    lost = play("lost", first, keeps=True, continues=True)
    assert "away" in lost["notice"]
    assert lost["counters"]["triangles"] > 0
    with serving(tmp_path / "again", *options) as second:
        stroke = {"op": "fill", "shape": "sphere", "center": [10, 212, 5], "radius": 6}
        answer = httpx2.post(f"{second.url}/v1/worlds/{WORLD}/edits", json={"strokes": [stroke]})
        assert answer.status_code == 200, answer.text
        assert answer.json()["revision"] == "2"
        found = play("back", second, continues=True)
    before, heard, after, fresh = (found[name] for name in ("before", "heard", "after", "fresh"))
    assert before["isAway"]
    assert before["world"] == WORLD
    assert [each["revision"] for each in (before, heard, after)] == ["1", "2", "3"]
    assert heard["triangles"] != before["triangles"], "the edit is not shown"
    assert after["triangles"] == fresh["triangles"]
    assert after["levels"] == fresh["levels"]
    assert found["isHidden"]
