"""docs/recipes: every block of the guide is a recipe or runs, and every picture and built-in is where it says."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from chunkserver.recipe import BUILTINS, canonical
from pages.views import VIEWS

FOLDER = Path(__file__).parents[2] / "docs" / "recipes"
GUIDE = (FOLDER / "guide.md").read_text()
GALLERY = (FOLDER / "README.md").read_text()
BLOCKS = re.findall(r"^```(json|python)\n(.*?)^```$", GUIDE, re.MULTILINE | re.DOTALL)
TREES = [json.loads(text) for kind, text in BLOCKS if kind == "json"]
PAIRS_MIN = 6


@pytest.mark.parametrize("tree", TREES)
def test_every_json_block_is_a_recipe(tree):
    assert canonical(tree)


def test_python_makes_the_json_below_it(capsys):
    names: dict[str, Any] = {}
    pairs = 0
    for (kind, text), (next_kind, next_text) in pairwise([*BLOCKS, ("", "")]):
        if kind == "python":
            exec(text, names)
            assert canonical(names["world"])
            if next_kind == "json":
                assert canonical(names["world"]) == canonical(json.loads(next_text)), text
                pairs += 1
    assert pairs >= PAIRS_MIN
    assert canonical(json.loads(capsys.readouterr().out)) == canonical("plane")


def test_the_pictures_of_the_guide_show_its_recipes():
    drawn = [view for view in VIEWS if view.name.startswith("guide-")]
    assert drawn
    for view in drawn:
        assert canonical(view.recipe) in map(canonical, TREES)
        assert f"(pictures/{view.name}.jpg)" in GUIDE


@pytest.mark.parametrize("page", [GUIDE, GALLERY])
def test_every_picture_is_there(page):
    pictures = re.findall(r"\(pictures/([a-z-]+)\.jpg\)", page)
    assert pictures
    for name in pictures:
        assert (FOLDER / "pictures" / f"{name}.jpg").stat().st_size > 4096
        assert name in {view.name for view in VIEWS}


@pytest.mark.parametrize("name", BUILTINS)
def test_the_gallery_has_every_built_in(name):
    (section,) = re.findall(rf"^## {name}$\n(.*?)(?=^## |\Z)", GALLERY, re.MULTILINE | re.DOTALL)
    assert str(BUILTINS[name].__doc__).split("\n\n")[0] in section
    schema = json.loads(re.findall(r"`(\{.*\})`", section)[0])
    assert canonical(schema) == canonical(name)
