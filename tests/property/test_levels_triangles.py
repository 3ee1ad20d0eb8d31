"""No level of a built-in recipe is speckle: few times the triangles per chunk of the finest, and no stray pieces.

The figures are those of docs/recipes/levels.md. `make torture` measures the views of the
page itself, `make test` ones of half the width.
"""

from functools import lru_cache

import pytest

from chunkserver.recipe import BUILTINS
from pages.levels import CHUNKS_ASIDE, GROWTH_MAX, Level
from pages.tables import levels_of
from tests.scale import TORTURE

ASIDE = CHUNKS_ASIDE if TORTURE else CHUNKS_ASIDE // 2

CHIPS = {"terrain": 22, "planet": 2, "spires": 1, "continents": 3}
"""Where a cave only grazes the ground, chips of rock are left: known, no more. The `max` of `terrain` is a promise."""
CHIPPED_LODS = 3


@lru_cache
def levels(name: str) -> list[Level]:
    return levels_of(name, ASIDE)


@pytest.mark.parametrize("name", BUILTINS)
def test_no_level_has_many_times_the_triangles_of_the_finest(name):
    finest = levels(name)[0]
    assert finest.chunks, "the reference view has no surface: give the recipe a place in pages/levels.py"
    assert max(level.triangles_mean for level in levels(name)) <= GROWTH_MAX * finest.triangles_mean
    assert max(level.triangles_max for level in levels(name)) <= GROWTH_MAX * finest.triangles_max


@pytest.mark.parametrize("name", BUILTINS)
def test_no_level_has_stray_pieces(name):
    assert all(level.stray <= (CHIPS.get(name, 0) if level.lod < CHIPPED_LODS else 0) for level in levels(name))
