"""What the viewer shows, in Chromium against the real server."""

from typing import Any, Final

import numpy as np
import pytest

from tests.browser.conftest import Play
from tests.browser.pictures import pixels
from tests.serving import Server

BACKGROUND: Final = (17, 22, 29)
"""Of every view but the shaded one: clients/viewer/src/look/views.ts."""
BACKGROUND_NEAR: Final = 12
SMALL: Final = {"viewport": {"width": 160, "height": 120}, "deviceScaleFactor": 1}
"""Each frame is read back."""


def test_a_planet_in_three_levels_and_four_views(play: Play, server: Server):
    found = play("levels", server)
    assert sum(count > 0 for count in found["levels"]) >= 3
    assert found["triangles"] > 10_000
    assert found["asked"] == 0, "chunks are asked for when all is shown"
    assert found["title"].startswith("Planet, seed 42")
    pictures = [pixels(view) for view in found["views"].values()]
    for number, picture in enumerate(pictures):
        assert picture[80:240].std() > 4, f"view {number} is blank"
        others = pictures[:number]
        assert all(np.abs(picture[80:240].astype(int) - other[80:240]).mean() > 3 for other in others), number


def test_no_background_through_a_seam(play: Play, server: Server):
    found = play("seams", server)
    assert len(found["levels"]) >= 3
    for number, picture in enumerate(map(pixels, found["pictures"])):
        away = np.abs(picture.astype(int) - BACKGROUND).max(axis=-1)
        assert np.count_nonzero(away < BACKGROUND_NEAR) == 0, f"picture {number}"
        assert picture.std() > 4, f"picture {number} is blank"


def test_no_frame_with_a_hole(play: Play, server: Server):
    found = play("flight", server, context=SMALL)
    assert found["holes"] == []
    assert found["angle"] > 0.45
    assert found["swaps"] >= 2  # a slow machine shows more changes in one
    assert found["frames"] > found["swaps"]


def test_chunks_of_one_edit_change_in_one_frame(play: Play, server: Server):
    found = play("swap", server, context=SMALL)
    assert found["holes"] == []
    (swap,) = found["swaps"]
    assert sorted(swap["went"]) == sorted(swap["came"])
    assert len(swap["came"]) >= 4
    assert len({lod for lod, *_ in swap["came"]}) >= 2
    assert all(_is_stale(chunk, found["stale"]) for chunk in swap["went"])


def _is_stale(chunk: list[int], stale: list[dict[str, Any]]) -> bool:
    lod, *place, _ = chunk
    return any(
        each["lod"] == lod
        and all(low <= at <= high for low, at, high in zip(each["min"], place, each["max"], strict=True))
        for each in stale
    )


def test_figures_are_true(play: Play, server: Server):
    found = play("figures", server)
    rows, counters, scene = (found["first"][name] for name in ("rows", "counters", "scene"))
    shown = {
        name: int(rows[name].replace(",", "")) for name in ("Chunks", "With triangles", "Triangles", "On their way")
    }
    assert shown == {
        "Chunks": counters["chunks"],
        "With triangles": scene["objects"],
        "Triangles": scene["triangles"],
        "On their way": 0,
    }
    assert sum(counters["levels"]) == scene["objects"] < counters["chunks"]
    assert rows["Revision"] == counters["revision"]
    assert float(rows["Per chunk"].removesuffix(" ms")) > 0
    assert 0 < _milliseconds(rows["Of it, scripts"]) < _milliseconds(rows["Frame to frame"])
    assert _milliseconds(rows["Frame to frame"]) > 10, "there are 60 frames a second at most"
    assert _bytes(rows["Meshes"]) == _about(scene["bytes"])
    assert _bytes(rows["Received"]) > 0.97 * found["received"] > 1e5
    assert found["broken"] or _bytes(rows["Received"]) == _about(found["received"])
    away, again = found["away"], found["again"]
    assert again["Triangles"] == rows["Triangles"] != away["Triangles"]
    assert int(again["Cache hits"]) > int(away["Cache hits"]) + 10
    assert _bytes(again["Received"]) - _bytes(away["Received"]) < 0.1 * _bytes(rows["Received"])


def _milliseconds(text: str) -> float:
    return float(text.removesuffix(" ms"))


def _bytes(text: str) -> float:
    number, unit = text.split()
    return float(number) * {"kB": 1e3, "MB": 1e6}[unit]


def _about(value: float) -> Any:
    return pytest.approx(value, rel=0.02, abs=1e3)
