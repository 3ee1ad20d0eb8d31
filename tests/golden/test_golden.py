"""Chunks are what they were."""

import pytest

from chunkserver.recipe import BUILTINS
from tests.golden.meshes import FILES, FOLDER


@pytest.mark.parametrize("name", FILES)
def test_as_written_down(name):
    """If a change is meant: `python -m tests.golden`, and look at the diff."""
    assert list(FILES[name]()) == (FOLDER / name).read_text().splitlines()


def test_there_is_something_to_compare():
    lines = (FOLDER / "chunks.txt").read_text().splitlines()
    assert {line.split()[0] for line in lines if " surface " in line} == set(BUILTINS), "each has a surface somewhere"
    assert 10 < len((FOLDER / "octant.txt").read_text().splitlines()) < 100
