"""The server's stream and the client's session in a world where everything breaks, on a clock that nobody waits for.

A failure names its seed: `python -m tests.sim SEED` shows what happened.
"""

import numpy as np
import pytest

from tests.scale import count
from tests.sim.checkers import GUARANTEES
from tests.sim.faults import FAULTS, Fault
from tests.sim.run import Run, play

SEEDS = count(100_000)
FOUND = {1120369873: "who skips edits is not told that its own ones, out of sight, go unanswered"}
"""Seeds that have found a fault of the server or of the client."""
FAULT_SEEDS = 300
"""After so many runs a planted fault has to be found."""


def violations(run: Run) -> list[str]:
    return [f"{name}: {line}" for name, check in GUARANTEES.items() for line in check(run)]


def test_everything_breaks_and_nothing_is_lost(rng: np.random.Generator):
    first = int(rng.integers(1 << 32))
    heard: set[str] = set()
    for seed in range(first, first + SEEDS):
        run = play(seed)
        heard.update(type(one.message).__name__ for player in run.players for one in player.heard)
        found = violations(run)
        assert not found, f"python -m tests.sim {seed}: {found[:5]}"
    assert heard == {"Welcome", "Ack", "Nack", "Edits", "Progress", "Stale", "Resync"}


@pytest.mark.parametrize("seed", FOUND)
def test_a_seed_that_found_a_fault_finds_none(seed: int):
    assert violations(play(seed)) == []


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_its_checker_finds_a_fault(fault: Fault, monkeypatch: pytest.MonkeyPatch):
    fault(monkeypatch)
    check = GUARANTEES[FAULTS[fault]]
    assert any(any(check(play(seed))) for seed in range(FAULT_SEEDS))


def test_a_run_follows_from_its_seed():
    runs = [[one for player in play(7).players for one in player.heard] for _ in range(2)]
    assert [one[:5] for one in runs[0]] == [one[:5] for one in runs[1]]
    assert len(runs[0]) > 10
