"""Pictures of the viewer: those that the script takes are there, shown, and small."""

import re
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "docs/pictures/viewer"
BYTES_MAX: Final = 400_000


def test_pictures_are_those_that_the_script_takes():
    script = (ROOT / "clients/viewer/pictures.mjs").read_text(encoding="utf-8")
    taken = re.findall(r"^  (\w+): \{ link:", script, re.MULTILINE)
    assert sorted(path.stem for path in FOLDER.iterdir()) == sorted(taken) != []


def test_pictures_are_shown():
    pages = "".join((ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/viewer.md"))
    assert {path.name for path in FOLDER.iterdir()} == set(re.findall(r"pictures/viewer/([\w.]+)\)", pages))


def test_pictures_are_small_enough_to_keep():
    assert {path.name: size for path in FOLDER.iterdir() if (size := path.stat().st_size) > BYTES_MAX} == {}
