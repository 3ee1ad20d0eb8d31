"""Skirts by pixels: hardly a hole is left between levels, hardly a wall stands in the air, for few triangles."""

import numpy as np
import pytest

from pages.meshes.chunks import around
from pages.meshes.skirts import FULL, LOOKOUTS, measure
from tests.scale import TORTURE

FEWER_HOLES = 20
WALLS_MAX = 1e-4
FOLDS_MAX = 2e-5
COST_MAX = 0.25
SMALL = (400, 250)
PROMISED = {lookout.name: lookout for lookout in LOOKOUTS if lookout.recipe in ("hills", "planet")}
"""Of others, where caves open in the ground or are all there is, the walls are published, and nothing is promised."""


SEEN = LOOKOUTS if TORTURE else [lookout._replace(eyes=lookout.eyes[:1]) for lookout in PROMISED.values()][:2]


@pytest.mark.parametrize("lookout", SEEN, ids=[lookout.name for lookout in SEEN])
def test_skirts_by_pixels(lookout):
    figures = measure(lookout, FULL if TORTURE else SMALL)
    assert figures.holes_without > 20
    assert figures.holes_with * FEWER_HOLES <= figures.holes_without
    assert figures.folds <= FOLDS_MAX * figures.land
    assert figures.triangles_without < figures.triangles_with <= (1 + COST_MAX) * figures.triangles_without
    if lookout.name in PROMISED:
        assert figures.walls <= WALLS_MAX * figures.land
        assert figures.background == 0


@pytest.mark.parametrize("lookout", LOOKOUTS, ids=[lookout.name for lookout in LOOKOUTS])
def test_a_lookout_is_filled_once_and_balanced(lookout):
    keys = around(lookout.middle, lookout.lods, lookout.reach)
    assert {key.lod for key in keys} == set(lookout.lods)
    assert sum(8**key.lod for key in keys) == (2 * lookout.reach) ** 3 * 8 ** lookout.lods[-1]
    lows, sides = np.array([key.low_corner(1) for key in keys]), np.array([key.step for key in keys])
    touch = ((lows[:, None] <= (lows + sides[:, None])) & (lows <= (lows + sides[:, None])[:, None])).all(axis=2)
    rows = np.array([lookout.lods.index(key.lod) for key in keys])
    assert np.abs(rows[:, None] - rows)[touch].max() == 1
