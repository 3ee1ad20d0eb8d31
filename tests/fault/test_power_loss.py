"""The power goes at any moment of the store's life, its recovery included; or the process is killed, and then the power
goes. What was acknowledged is there again.
"""

import shutil
from contextlib import closing
from pathlib import Path
from unittest import mock

import apsw
import numpy as np
import pytest

from chunkserver.store import Draft, Store, foundation, sqlite, sweeping
from chunkserver.world import World
from tests.fault.disk import Content, Disk, Image
from tests.fault.history import PLANE, History
from tests.scale import count

CRASHES = max(300, count(10_000))
LIVES_OF_A_FILE = 25
OPERATIONS_MAX = 160
STEPS_MAX = 12
KILLED = 0.3
"""Of the lives, how many end without a loss of power."""


class LostError(AssertionError):
    """The store is not what it had said."""


@pytest.fixture(autouse=True)
def often(monkeypatch):
    """The write-ahead log is short, so that it is copied into the file within a short life. So are steps."""
    monkeypatch.setattr(sqlite, "CHECKPOINT_PAGES", 12)
    for module in (foundation, sweeping):
        monkeypatch.setattr(module, "STEP_ROWS_MAX", 2)


def lives(folder: Path, rng: np.random.Generator, crashes: int) -> None:
    """Have a store live and lose its power, so many times. Raises `LostError` if it breaks its word."""
    for number in range(crashes):
        if number % LIVES_OF_A_FILE == 0:
            image = Image()
            possible = [History()]
        image, possible = life(folder / str(number), image, possible, rng)


def life(folder: Path, image: Image, possible: list[History], rng: np.random.Generator) -> tuple[Image, list[History]]:
    """Open the store on what the disk has, look at it, use it until the power goes or it is killed.

    possible: what it may be: as it was when that happened, with or without what was just being done.

    Returns what the disk has then, and what that may be.
    """
    left = int(rng.integers(1, OPERATIONS_MAX))
    lost: list[tuple[Image, list[History]]] = []

    def pull_plug(*_: str) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            lost.append((end(), possible))

    def may_be(histories: list[History]) -> None:
        nonlocal possible
        possible = histories

    def end() -> Image:
        return disk.after_kill() if rng.random() < KILLED else disk.after_power_loss(rng)

    folder.mkdir()
    image.write(folder)
    with Disk(pull_plug, image) as disk:
        with closing(Store(folder)) as store:
            if not lost:
                possible = [as_it_is(store, possible, rng)]
            for _ in range(STEPS_MAX):
                if lost:
                    break
                possible[0].step(rng).take(store, may_be)
        if not lost:
            lost.append((end(), possible))
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


def test_what_a_killed_server_had_not_synced_is_synced_before_it_is_acknowledged(tmp_path):
    """Its edit is in the log, but not on the disk. The next server says that it was written: then it has to be."""
    world = World(id="w", recipe=PLANE, recipe_name="plane", generator="0123")
    draft = Draft(epoch=world.epoch, digest=b"", strokes=b"x", stale=b"", client="c", seq=1)
    before_syncs: list[Image] = []
    folders = [tmp_path / name for name in ("killed", "next", "last")]

    def look(kind: str, _name: str) -> None:
        if kind == "sync":
            before_syncs.append(disk.after_kill())

    with Disk(look) as disk, closing(Store(folders[0])) as store:
        store.catalogue.create(world)
        store.log.append([draft])
        killed = before_syncs[-1]
    folders[1].mkdir()
    killed.write(folders[1])
    with Disk(image=killed) as disk, closing(Store(folders[1])) as store:
        assert store.log.append([draft]) == [(1, b"", True)]
        left = {name: Content(content.synced) for name, content in disk.durable_entries.items()}
    folders[2].mkdir()
    Image(left).write(folders[2])
    with closing(Store(folders[2])) as store:
        assert store.log.revision(world.epoch) == 1


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
