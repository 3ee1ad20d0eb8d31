"""docs/level-of-detail.md: its example, by a twin that was written from the page, and by the Python client."""

import json
import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from chunkserver_client import LevelOfDetail, Recipe, SeedDescriptor
from tests.client import slow_cuts

PAGE: Final = (Path(__file__).parents[2] / "docs/level-of-detail.md").read_text(encoding="utf-8")


def stated(name: str) -> Any:
    (text,) = re.findall(rf"^```json {name}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    return json.loads(text)


VIEW: Final = stated("view")
FRAMES: Final = stated("frames")
WORLD: Final = slow_cuts.World(VIEW["chunk_cells"], VIEW["lods"], tuple(VIEW["box"]))
RUNGS: Final = slow_cuts.ladder(WORLD, VIEW["geometric_errors"], VIEW)


def rows(frame: dict[str, Any]) -> list[tuple[int, ...]]:
    assert frame["count"] == len(frame["chunks"])
    return [tuple(row) for row in frame["chunks"]]


def test_the_twin_sees_what_the_page_says():
    assert VIEW["distances"] == RUNGS[0].distances
    before = None
    for frame in FRAMES:
        at = [math.floor(voxel) for voxel in frame["position"]]
        ahead = [math.floor(speed * VIEW["ahead_seconds"]) for speed in frame["velocity"]]
        before = slow_cuts.select(WORLD, RUNGS, at, ahead, before, VIEW["chunks_max"])
        assert sorted(before[1].rows) == rows(frame)


def test_the_client_sees_what_the_page_says():
    world = SeedDescriptor(
        seed=1,
        recipe=Recipe(digest="d", name="plane", parameters={}, expression={}),
        generator="g",
        voxel_size=0.5,
        chunk_cells=VIEW["chunk_cells"],
        lods=VIEW["lods"],
        low=(-(1 << 40),) * 3,
        high=(1 << 40,) * 3,
        formats=(),
        meshers=(),
        seams=(),
        coarser=(),
    )
    chosen = ("error_pixels", "screen_pixels", "fov_degrees", "ahead_seconds", "reach", "box", "chunks_max")
    levels = LevelOfDetail(world, **{name: VIEW[name] for name in chosen})
    selection = None
    for frame in FRAMES:
        selection = levels.select(frame["position"], frame["velocity"], selection)
        assert sorted(selection.chunks) == rows(frame)


def test_the_example_shows_each_rule():
    counts = [frame["count"] for frame in FRAMES]
    assert [b - a for a, b in pairwise(counts)][1:3] == [0, counts[0] - counts[1]], "it stays, then it merges"
    assert any(row[0] == 2 for row in FRAMES[0]["chunks"])
    assert not any(row[0] == 2 for row in FRAMES[1]["chunks"]), "the balance splits a root"


def test_the_defaults_are_those_of_the_client():
    stated_defaults = dict(re.findall(r"^\| `(\w+)` \|.*\| ([\d.]+) \|$", PAGE, re.MULTILINE))
    given = LevelOfDetail.__init__.__kwdefaults__ or {}
    assert stated_defaults == {
        "error_pixels": f"{given['error_pixels']:g}",
        "ahead_seconds": f"{given['ahead_seconds']:g}",
        "chunks_max": str(given["chunks_max"]),
    }
    assert f"| {given['screen_pixels']:g}, {given['fov_degrees']:g} |" in PAGE
