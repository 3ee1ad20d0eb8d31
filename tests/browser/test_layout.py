"""Where everything is on small and large screens, and whether everybody can use it."""

from itertools import combinations
from typing import Any, Final

import pytest

from tests.browser.conftest import Play
from tests.serving import Server

PHONE: Final = {"viewport": {"width": 390, "height": 844}, "hasTouch": True, "deviceScaleFactor": 1}
DESK: Final = {"viewport": {"width": 1280, "height": 800}, "deviceScaleFactor": 1}
SMALL: Final = {"viewport": {"width": 160, "height": 120}}
CONTRAST_LEAST: Final = 4.5
OVER: Final = {"world", "figures", "help"}
"""What is in front of other things, as long as it is open; not of the bar that opens and closes it."""
BAR: Final = {"show-world", "views", "share", "show-figures", "show-help"}


@pytest.mark.parametrize("context", [PHONE, DESK], ids=["phone", "desk"])
def test_nothing_is_in_the_way(play: Play, server: Server, context: dict[str, Any]):
    found = play("layout", server, context=context)
    width, height, scroll_width = found["size"]
    assert [width, height] == list(context["viewport"].values())
    assert scroll_width == width
    for state, seen in found["states"].items():
        boxes = seen["boxes"]
        for name, box in boxes.items():
            inside = box["left"] >= 0 and box["top"] >= 0 and box["right"] <= width and box["bottom"] <= height
            assert inside, f"{state}: {name} is not on the screen: {box}"
            assert not box["cut"], f"{state}: text of {name} is cut off"
        for one, other in combinations(boxes, 2):
            is_over = {one, other} & OVER and not ({one, other} & BAR and "help" not in (one, other))
            assert is_over or not _meet(boxes[one], boxes[other]), f"{state}: {one} is in front of {other}"
    assert ("up" in found["states"]["first"]["boxes"]) == ("hasTouch" in context)


def _meet(one: dict[str, float], other: dict[str, float]) -> bool:
    return (
        one["left"] < other["right"]
        and other["left"] < one["right"]
        and one["top"] < other["bottom"]
        and other["top"] < one["bottom"]
    )


def test_everybody_can_use_it(play: Play, server: Server):
    found = play("access", server, context=DESK)
    assert len(found["controls"]) > 15
    assert [role for role, name in found["controls"] if not name.strip() and role != "RootWebArea"] == []
    stops = dict(found["stops"])
    assert stops.keys() >= {"view", "show-world", "share", "walk", "radius", "recipe", "seed", "json", "normals"}
    del stops["body"]
    assert [name for name, (style, width) in stops.items() if style == "none" or width < 2] == []
    assert len(found["contrasts"]) > 30
    assert {text: ratio for text, ratio in found["contrasts"].items() if ratio < CONTRAST_LEAST} == {}
    assert found["helps"] == [True, False]
    assert found["focused"] == "show-help"


@pytest.mark.parametrize("asked", [{"forcedColors": "active"}, {"contrast": "more"}], ids=["forced", "more"])
def test_who_asks_for_contrast_has_it(play: Play, server: Server, asked: dict[str, str]):
    found = play("colours", server, context=SMALL | asked)
    assert found["chosen"]["behind"] != found["other"]["behind"]
    assert found["pressed"]["behind"] != found["plain"]["behind"]
    if "forcedColors" in asked:
        assert found["chosen"]["behind"] == found["pressed"]["behind"] == found["selected"]["behind"]
    else:
        assert "rgba" not in found["panel"]["behind"], "nothing is seen through it"
        quiet = [int(part) for part in found["other"]["text"].removeprefix("rgb(").removesuffix(")").split(",")]
        assert min(quiet) > 220


def test_nothing_moves_for_those_who_want_that(play: Play, server: Server):
    assert 0 not in play("calm", server, context=SMALL, motion="no-preference", tries=12)["drawn"], (
        "1.5 s are 75 frames"
    )
    assert play("calm", server, context=SMALL, motion="reduce", tries=60)["drawn"][-1] == 0
