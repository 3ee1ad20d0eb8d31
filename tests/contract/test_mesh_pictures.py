"""Pictures of meshes and the page that shows them are those of the table."""

import re
from pathlib import Path

from pages.__main__ import GENERATORS
from pages.meshes import PICTURES, write_page

DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "pictures" / "meshes"
BYTES_MAX = 500_000


def test_the_page_is_written_from_the_table(tmp_path):
    """If a picture has changed: `python -m pages meshes`."""
    assert (DOCS / "meshes.md").read_text() == write_page(tmp_path).read_text()


def test_each_picture_that_is_named_exists_and_each_that_exists_is_named():
    named = re.findall(r"\]\((pictures/meshes/[^)]+)\)", (DOCS / "meshes.md").read_text())
    assert len(named) == len(set(named))
    assert {DOCS / name for name in named} == set(FOLDER.iterdir())
    assert {f"{picture.name}.jpg" for picture in PICTURES} == {path.name for path in FOLDER.iterdir()}


def test_pictures_are_small_enough_to_keep():
    assert {path.name for path in FOLDER.iterdir() if path.stat().st_size > BYTES_MAX} == set()


def test_each_picture_is_drawn_by_its_name():
    assert {name for name in GENERATORS if name.startswith("mesh-")} == {f"mesh-{p.name}" for p in PICTURES}
