"""The power goes at any moment of the store's life, its recovery included. What it had acknowledged is there again."""

import shutil
from contextlib import closing
from pathlib import Path
from unittest import mock

import apsw
import numpy as np
import pytest

from chunkserver.store import Store, sqlite
from tests.fault.disk import Disk, Image
from tests.fault.history import History
from tests.scale import count

CRASHES = max(300, count(10_000))
LIVES_OF_A_FILE = 25
OPERATIONS_MAX = 160
STEPS_MAX = 12


class LostError(AssertionError):
    """The store is not what it had said."""


@pytest.fixture(autouse=True)
def often(monkeypatch):
    """The write-ahead log is short, so that it is copied into the file within a short life."""
    monkeypatch.setattr(sqlite, "CHECKPOINT_PAGES", 12)


def lives(folder: Path, rng: np.random.Generator, crashes: int) -> None:
    """Have a store live and lose its power, so many times. Raises `LostError` if it breaks its word."""
    for number in range(crashes):
        if number % LIVES_OF_A_FILE == 0:
            image: Image = {}
            possible = [History()]
        image, possible = life(folder / str(number), image, possible, rng)


def life(folder: Path, image: Image, possible: list[History], rng: np.random.Generator) -> tuple[Image, list[History]]:
    """Open the store on what the disk has, look at it, use it until the power goes.

    possible: what it may be: as it was when the power went, with or without what was just being done.

    Returns what the disk has then, and what that may be.
    """
    left = int(rng.integers(1, OPERATIONS_MAX))
    lost: list[tuple[Image, list[History]]] = []

    def pull_plug(*_: str) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            lost.append((disk.after_power_loss(rng), possible))

    folder.mkdir()
    for name, content in image.items():
        (folder / name).write_bytes(content)
    with Disk(pull_plug, image) as disk:
        with closing(Store(folder)) as store:
            if not lost:
                possible = [as_it_is(store, possible, rng)]
            for _ in range(STEPS_MAX):
                if lost:
                    break
                action, after = possible[0].step(rng)
                possible = [possible[0], after]
                action(store)
                possible = possible if lost else [after]
        if not lost:
            lost.append((disk.after_power_loss(rng), possible))
    shutil.rmtree(folder)
    return lost[0]


def as_it_is(store: Store, possible: list[History], rng: np.random.Generator) -> History:
    faults = []
    for history in possible:
        fault = history.fault_in(store) or history.sent_again(store, rng)
        if not fault:
            return history
        faults.append(fault)
    raise LostError(f"after a loss of power: {'; or '.join(faults)}")


def test_what_was_acknowledged_outlives_the_power(tmp_path, rng):
    lives(tmp_path, rng, CRASHES)


class Careless(apsw.Connection):
    """Syncs only now and then, and says that it always does."""

    def pragma(self, name, value=None, **options):
        if name != "synchronous":
            return super().pragma(name, value, **options) if value is not None else super().pragma(name, **options)
        return super().pragma(name, "normal") if value else 2


def test_the_loss_would_be_seen(tmp_path, rng):
    """The control: the same lives with synchronous = NORMAL."""
    with mock.patch.object(apsw, "Connection", Careless), pytest.raises(LostError, match="after a loss of power"):
        lives(tmp_path, rng, CRASHES)
