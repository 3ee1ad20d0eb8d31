"""Mouse, keys and fingers: each does what the help says, and nothing else."""

import pytest

from tests.browser.conftest import Play
from tests.serving import Server

TOUCH = {"hasTouch": True}


def test_the_mouse(play: Play, server: Server):
    found = play("mouse", server)
    free, locked, freed = found["hints"]
    assert free == freed
    assert "Esc" in locked
    assert found["free"] == found["freed"] == {"onwards": 0, "right": 0, "up": 0}
    assert not found["menu"], "there is a menu"
    assert found["untouched"] == 0, "the click that takes the mouse digs"
    assert found["sideways"]["right"] > 0.05
    assert abs(found["sideways"]["up"]) < 1e-9
    assert found["down"]["up"] < -0.05
    before, dug, built = found["sights"]
    assert dug > before + 3
    assert built < dug - 3
    first, larger, largest, smaller = found["radii"]
    assert largest > larger > first
    assert smaller == pytest.approx(larger, abs=0.5)
    assert found["revisions"] == [found["revisions"][0] + number for number in range(3)]
    assert found["ended"][0] >= found["revisions"][-1] + 2
    assert found["ended"][0] == found["ended"][1], "it is dug on without the mouse"


def test_the_keyboard_alone(play: Play, server: Server):
    found = play("keyboard", server)
    ways = found["ways"]
    assert ways["KeyS"]["onwards"] < -1
    assert abs(ways["KeyS"]["right"]) < 0.1
    assert ways["KeyD"]["right"] > 1.5
    assert ways["Space"]["up"] > 1.5
    assert ways["ArrowLeft"]["right"] < -0.09
    assert ways["ArrowRight"]["right"] > 0.09
    assert ways["ArrowUp"]["up"] > 0.05
    assert 1 < found["altitude"] < 2
    assert found["view"] == "levels"
    assert found["title"].startswith("Planet, seed 7 ")


def test_nobody_goes_on_for_ever(play: Play, server: Server):
    assert play("stuck", server) == {"meta": True, "blur": True, "hidden": True}


def test_fingers(play: Play, server: Server):
    found = play("touch", server, context=TOUCH)
    left, right, both = found["left"], found["right"], found["both"]
    assert left["moved"]["onwards"] < -1, "the left half moves: downwards is backwards"
    assert abs(left["moved"]["right"]) < 0.1
    assert abs(left["turned"]["right"]) < 1e-6, "the left half only moves"
    assert right["turned"]["right"] == pytest.approx(0.2, abs=0.03), "40 pixels of 0.0055 radians, above a slope"
    assert max(map(abs, right["moved"].values())) < 0.02, "the right half only turns"
    assert both["moved"]["right"] > 1
    assert both["turned"]["right"] < -0.1
    before, dug, built = found["sights"]
    assert dug > before + 3
    assert built < dug - 3


def test_the_buttons_of_a_touch_screen_have_keys(play: Play, server: Server):
    found = play("pads", server, context=TOUCH)
    assert found["up"] > 1.5
    assert found["down"] < -1.5
