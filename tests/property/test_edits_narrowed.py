"""A history folds edits in boxes that bounds have narrowed; it makes what their strokes make in all of their boxes.

Edits wait, are folded some at once or dropped, as a server may do it; work is cut into pieces of any size.
"""

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit, History, Taken, draft, runs
from chunkserver.errors import Overloaded
from chunkserver.recipe import WorldRecipe, builtin
from tests.scale import count
from tests.strokes import bounds_of, field_of, no_bricks, random_stroke, small_arena

SEQUENCES = 400
SEQUENCES_MIN = 8
EDITS = 16
MIDDLES = {
    "plane": [(0.0, 0.0, 0.0), (2.0**39, 0.0, -(2.0**39)), (3.0, 1e5, 2.0), (3.0, -1e5, 2.0)],
    "sphere": [(0.0, 48.0, 0.0), (2.0**39, 0.0, -(2.0**39))],
}
"""Near surfaces, and where the field is clamped."""
SLOTS = 950
"""Room for three of the largest edits, which wait or are dropped; more are refused until some are folded."""


@pytest.mark.parametrize("world", MIDDLES)
def test_boxes_outside_which_nothing_changes(world, rng, monkeypatch):
    recipe = WorldRecipe(7, builtin(world))
    field = field_of(recipe)
    smaller = 0
    for _ in range(max(SEQUENCES_MIN, count(SEQUENCES)) // len(MIDDLES)):
        monkeypatch.setattr(runs, "RUN_POINTS", int(rng.choice([1, 1000, 1 << 20])))
        monkeypatch.setattr(draft, "BOXES_AT_ONCE", int(rng.choice([1, 4, 1 << 12])))
        monkeypatch.setattr(draft, "LEVELS_AT_ONCE", int(rng.choice([1, 2, 4])))
        middle = np.array(MIDDLES[world][rng.integers(len(MIDDLES[world]))])
        lods = int(rng.choice([1, 4, 21]))
        history = History(Bricks(lods, small_arena(SLOTS)), bounds_of(recipe), 32)
        written: list[Edit] = []
        for _ in range(EDITS):
            one, other = (edit_near(middle, rng) for _ in range(2))
            taken = take(history, one, field)
            if rng.random() < 0.3:  # the log has it already, as is found out when the next one is taken
                dropped, one, taken = taken, other, take(history, other, field)
                history.dropped(dropped)
            smaller += taken.edit.brushes.points().sum() < one.brushes.points().sum()
            written.append(one)
            history.written(taken, len(written))
            if rng.random() < 0.4:
                fold(history, int(rng.integers(1, 5)), field)
        while history.waiting:
            fold(history, int(rng.integers(1, 5)), field)
        plain = no_bricks(lods).apply(written, len(written), field)
        assert contents(history.bricks) == contents(plain)
    assert smaller > 0


@pytest.mark.parametrize(("y", "first", "then"), [(-1e5, "carve", "fill"), (1e5, "fill", "carve")])
def test_what_was_made_far_from_any_surface_can_be_undone(y, first, then):
    """The field's bounds are far beyond what it is clamped to there."""
    recipe, ball = WorldRecipe(7, builtin("plane")), {"shape": "sphere", "center": [1, y, 2], "radius": 6.0}
    history = History(no_bricks(3), bounds_of(recipe), 32)
    for revision, op in enumerate((first, then), 1):
        taken = history.take(Edit.of([ball | {"op": op}]))
        assert taken.stale
        history.written(taken, revision)
        fold(history, 1, field_of(recipe))
    key = (0, 0, int(y) // 16, 0)
    brick = history.bricks.get(key)
    assert brick is not None
    density = np.clip(y, -65536, 65536) + brick.deltas[int(y) % 16, 2, 1] / 1024
    assert density == (6.0 if then == "carve" else -6.0)


def edit_near(middle, rng: np.random.Generator) -> Edit:
    at = (tuple(middle + rng.uniform(-25, 25, 3)) for _ in range(int(rng.integers(1, 4))))
    return Edit.of([random_stroke(rng, place, float(rng.uniform(0.5, 8))) for place in at])


def take(history: History, edit: Edit, field) -> Taken:
    try:
        return history.take(edit)
    except Overloaded:  # until those that wait are folded
        while history.unfolded(1):
            fold(history, 4, field)
        return history.take(edit)


def fold(history: History, at_once: int, field) -> None:
    edits = history.unfolded(at_once)
    history.publish(history.bricks.apply(edits, history.bricks.revision + len(edits), field))


def contents(bricks: Bricks) -> dict[tuple[int, ...], bytes]:
    return {key: brick.deltas.tobytes() for key, brick in bricks}
