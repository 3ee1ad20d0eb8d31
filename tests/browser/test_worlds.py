"""Which world is shown, and from where."""

import math

import pytest

from tests.browser.conftest import Play
from tests.serving import Server


def test_a_link_restores_world_and_camera(play: Play, server: Server):
    found = play("link", server)
    first, second = found["cameras"]
    assert first["position"] == second["position"] == [1000000123.25, 90.5, -2000000.75]
    assert first["ahead"] == pytest.approx(second["ahead"], abs=1e-3)
    assert found["title"].startswith("Hills, seed -7")
    assert found["counters"]["triangles"] > 0


def test_a_recipe_is_edited(play: Play, server: Server):
    found = play("recipe", server)
    assert found["error"].startswith("Line 4. b: should have a known op")
    assert found["error"].endswith("'detail'"), "all ops that there are"
    assert found["isInvalid"] == "true"
    assert found["after"] == ""
    assert "Infinity" in found["infinite"]
    assert "fault" not in found["infinite"]
    assert "recipe=plane" not in found["hash"]
    assert "like=plane" in found["hash"], "it looks like what it was made of"


def test_the_way_back(play: Play, server: Server):
    found = play("wayBack", server)
    assert found["typed"] == "seven", "who enters a seed is not interrupted"
    assert "whole number" in found["refused"]
    assert found["forgiven"] == ""
    assert found["hash"].startswith("#recipe=sphere&seed=7")
    assert found["seed"] == "1"
    assert found["camera"]["position"] == [0, 40, 7]


def test_a_link_to_no_world(play: Play, server: Server):
    found = play("absent", server)
    assert "not-there" in found["notice"]
    assert {"Planet", "Plane", "Terrain"} <= set(found["choices"])
    assert found["title"].startswith("Plane, seed ")
    assert found["isHidden"]


def test_nobody_begins_in_rock(play: Play, server: Server):
    found = play("buried", server)
    assert math.dist(found["begun"], (0, 90, 44)) < 28
    assert found["linked"] == [0, 80, 0]
