"""What goes wrong between the page and the server, in a browser; the rest is in clients/viewer/tests."""

from pathlib import Path
from typing import Final

import pytest

from chunkserver.server import mint
from tests.browser.conftest import Play
from tests.serving import Server, serving

SOCKETS_MAX: Final = 20
SOCKETS_PER_SECOND_MAX: Final = 4
"""Of two pages: there were hundreds if a connection were tried at once each time."""


@pytest.fixture
def own(tmp_path: Path):
    with serving(tmp_path / "log", "--workers", "1") as running:
        yield running


def test_edits_come_without_websockets(play: Play, own: Server):
    found = play("deaf", own)
    assert "a little later" in found["notice"]
    assert not found["wasAway"], "the server is said to be away, and chunks come"
    assert [each["revision"] for each in found["after"]] == ["1", "1"]
    assert found["after"][0]["triangles"] == found["after"][1]["triangles"] != found["before"]["triangles"]
    assert not any(each["isLive"] for each in found["after"])
    assert 2 <= found["sockets"] <= SOCKETS_MAX + SOCKETS_PER_SECOND_MAX * found["seconds"]


def test_an_edit_whose_answers_are_lost_is_written_once(play: Play, own: Server):
    found = play("unanswered", own)
    assert "sent again" in found["notice"]
    assert len(found["keys"]) > 3
    assert len(set(found["keys"])) == 1
    assert found["written"] == 1


def test_an_edit_that_is_refused_is_said_to_be_lost(play: Play, own: Server):
    found = play("refused", own)
    assert "lost" in found["notice"]
    assert "the ball is too round" in found["notice"]
    assert found["counters"]["revision"] == "0"


def test_answers_that_are_none_are_asked_for_again(play: Play, server: Server):
    found = play("garbled", server)
    assert "text/html" in found["notice"]
    assert not found["isAway"]
    assert found["isSame"], "the page was loaded anew"
    assert found["after"]["triangles"] > 0


def test_a_worker_that_does_not_come(play: Play, server: Server):
    assert "Reload the page" in play("workerless", server)["notice"]


def test_a_key_where_nothing_is_stored(play: Play, tmp_path: Path):
    key, kept = mint("one", "admin")
    with serving(tmp_path / "log", "--workers", "1", "--api-keys", str(kept)) as keyed:
        assert play("storeless", keyed, key=key)["triangles"] > 0


def test_the_picture_of_a_world_stays_until_there_is_one_of_the_next(play: Play, server: Server):
    found = play("swapped", server)
    assert found["least"]["frames"] > 5
    assert found["least"]["triangles"] > 0, "there was a frame without anything"
    assert found["after"]["triangles"] != found["before"]["triangles"]
