"""From one selection to the next without a hole: whatever is done first, what is drawn fits at all times."""

from collections.abc import Set

import numpy as np
import pytest

from chunkserver_client import FittedChunk, LevelOfDetail, swaps
from tests.client.worlds import assert_fits, volume, world

LODS, CELLS = 4, 16
SIDE = CELLS << LODS
BOX = ((-SIDE, -SIDE // 2, 0), (SIDE, SIDE // 2, SIDE))
LEVELS = LevelOfDetail(world(LODS, CELLS), error_pixels=24, reach=4 * SIDE, box=BOX)


def shown(*at: float) -> frozenset[FittedChunk]:
    return LEVELS.select(at).chunks


def assert_whole(drawn: Set[FittedChunk]) -> None:
    assert_fits(drawn, LODS)
    assert volume(drawn, CELLS) == volume(shown(0, 0, 0), CELLS)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((0, 0, 0), (9, 3, 40)),
        ((-200, 0, 10), (200, 50, 200)),
        ((0, 0, 100), (250, -100, 200)),
        ((5, 5, 5), (30, 5, 5)),
    ],
)
def test_in_any_order_and_stopped_anywhere_nothing_gapes(before, after):
    rng = np.random.default_rng(7)
    wanted = shown(*after)
    steps = swaps(shown(*before), wanted)
    for _ in range(3):
        drawn = set(shown(*before))
        for at in rng.permutation(len(steps)):
            drawn = (drawn - steps[at].old) | steps[at].new
            assert_whole(drawn)
        assert drawn == wanted


def test_who_changes_his_mind_goes_on_from_what_is_drawn():
    drawn = set(shown(0, 0, 0))
    for wanted in (shown(100, 40, 90), shown(-100, 40, 90), shown(0, 0, 0)):
        for step in swaps(drawn, wanted)[::2]:
            drawn = (drawn - step.old) | step.new
        assert_whole(drawn)


def test_a_short_way_is_many_small_steps():
    near, far = shown(-100, 0, 60), shown(-80, 0, 60)
    steps = swaps(near, far)
    assert frozenset().union(*(step.old for step in steps)) == near - far
    assert frozenset().union(*(step.new for step in steps)) == far - near
    assert not near & frozenset().union(*(step.new for step in steps))
    apart = shown(-250, -120, 10)
    both = {chunk for chunk in apart if chunk.x < 0} | {chunk for chunk in near if chunk.x >= 0}
    assert len(swaps(near, both)) >= 1
    assert swaps(near, near) == []


def test_groups_do_not_touch():
    a, b = FittedChunk(1, 0, 0, 0, 0), FittedChunk(1, 2, 0, 0, 0)
    assert len(swaps({a, b}, {a._replace(coarser=1), b._replace(coarser=1)})) == 2
    corner = FittedChunk(0, 2, 2, 2, 0)
    assert len(swaps({a}, {corner})) == 1, "touching at a corner is touching"
    inside = FittedChunk(0, 1, 1, 1, 0)
    assert swaps({a}, {inside}) == [(frozenset({a}), frozenset({inside}))]
    assert len(swaps({a}, {FittedChunk(0, 3, 2, 2, 0)})) == 2
    assert len(swaps({FittedChunk(3, -1, -1, -1, 0)}, {FittedChunk(0, 0, 0, 0, 0)})) == 1, "across zero"


def test_all_at_once_is_a_swap_too():
    new = shown(0, 0, 0)
    assert frozenset().union(*(step.new for step in swaps(set(), new))) == new
    assert frozenset().union(*(step.old for step in swaps(new, set()))) == new
