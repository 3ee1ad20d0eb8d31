"""Microseconds of CPU per edit, without HTTP and without the log: what a server's own process has to do.

Edits are spread over 512 x 512 voxels of the ground of `terrain`, in a world of 12 levels that they share.

- Read: from JSON to strokes that are known to be good, and the bytes that a log keeps.
- Reach: what the edit can change, and so which chunks are stale, on all levels.
- Note: that it was taken, what is answered, and that it was written. The log, which comes between, has its own table.
- Fold: its deltas, and those of the coarser levels; in a thread beside. Alone: each edit by itself, as when few come.
  64 at once: as when many do.
- Publish: that its bricks can be read.
"""

import json
import random
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final

from benchmarks.editing import ADDS, Stroke, adds, carves
from benchmarks.measure import US, Figure, Line, Scale, in_turns
from chunkserver.edits import Arena, Bricks, Edit, History
from chunkserver.field import Ground
from chunkserver.grid import CELLS_DEFAULT
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.world import LODS_DEFAULT

SEED: Final = 42
STAGES: Final = ("read", "reach", "note", "fold", "publish")
KINDS: Final = {"a carve": (1, carves), f"{ADDS} adds": (ADDS, adds)}
AT_ONCE: Final = {"alone": 1, "64 at once": 64}
EDITS: Final = {"a carve": 4, f"{ADDS} adds": 1}
"""Of a round, for each chunk that other benchmarks have in rotation."""
ROUNDS_MAX: Final = 5


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for each kind of edit, and for each way to fold it."""
    candidates = {
        f"{kind}, {way}": partial(_turn, make, strokes, EDITS[kind] * scale.chunks, at_once)
        for kind, (strokes, make) in KINDS.items()
        for way, at_once in AT_ONCE.items()
    }
    for subject, turns in in_turns(candidates, min(scale.rounds, ROUNDS_MAX)).items():
        figures = [Figure(stage, "us", tuple(turn[stage] for turn in turns)) for stage in STAGES]
        yield Line(subject, (*figures, Figure("all", "us", tuple(sum(turn.values()) for turn in turns))))


def _turn(
    make: Callable[[int, random.Random], list[Stroke]], strokes: int, count: int, at_once: int
) -> dict[str, float]:
    """Return microseconds of CPU per edit of each stage, for so many edits of a new world."""
    at = random.Random(SEED)
    bodies = [json.dumps({"strokes": make(strokes, at)}) for _ in range(count)]
    ground = Ground(WorldRecipe(SEED, builtin("terrain")))
    history = History(Bricks(LODS_DEFAULT, Arena()), ground.bound, CELLS_DEFAULT)
    spent = dict.fromkeys(STAGES, 0.0)
    for first in range(0, count, at_once):
        some = bodies[first : first + at_once]
        for body in some:
            clock = _Clock(spent)
            edit = Edit.of(json.loads(body)["strokes"])
            clock.note("read")
            taken = history.measuring(edit)()
            clock.note("reach")
            assert history.took(taken).told
            history.written(taken, history.revision + 1)
            clock.note("note")
        clock = _Clock(spent)
        edits = history.unfolded(at_once)
        bricks = history.bricks.apply(edits, history.revision, lambda box: ground.sample(box.low, box.shape))
        clock.note("fold")
        history.publish(bricks)
        clock.note("publish")
    return {stage: seconds * US / count for stage, seconds in spent.items()}


class _Clock:
    """Adds up how long stages take. One follows the other."""

    def __init__(self, spent: dict[str, float]) -> None:
        self._spent = spent
        self._then = time.thread_time()

    def note(self, stage: str) -> None:
        now = time.thread_time()
        self._spent[stage] += now - self._then
        self._then = now
