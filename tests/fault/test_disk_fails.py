"""The disk fails, or is full, at every single write and sync of a run: nothing is acknowledged that is not there."""

import shutil
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import apsw
import numpy as np
import pytest

from chunkserver.errors import StoreError, StoreFull
from chunkserver.store import Draft, Store, foundation, sqlite, sweeping
from chunkserver.store.draft import EDIT_BYTES_MAX
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.world import World
from tests.fault.disk import Disk
from tests.fault.history import PLANE, History
from tests.scale import TORTURE

STEPS = 16
STRIDE = 1 if TORTURE else 13
"""Between two places where a write fails. Syncs are few: each of them fails in every run."""
OPERATIONS_MAX = 2000
SECONDS_MAX = 20.0
SEED = 2
"""Of what is done: the same in every run, so that each has the operations of the one before."""


class Fails:
    """The `at`-th operation of some kinds fails, and `times` - 1 more."""

    def __init__(self, at: int, kinds: tuple[str, ...], error: type[apsw.Error], extended: int, times: int = 1) -> None:
        self.at, self.kinds, self.error, self.extended, self.times = at, kinds, error, extended, times
        self.seen = 0

    def __call__(self, kind: str, _name: str) -> None:
        if kind in self.kinds:
            self.seen += 1
            if self.at <= self.seen < self.at + self.times:
                fault = self.error(f"a {kind} that fails")
                fault.extendedresult = self.extended  # type: ignore[attr-defined] # SQLite is told this
                raise fault

    @property
    def happened(self) -> bool:
        return self.seen >= self.at


@pytest.fixture(autouse=True)
def often(monkeypatch):
    monkeypatch.setattr(sqlite, "CHECKPOINT_PAGES", 12)
    for module in (foundation, sweeping):
        monkeypatch.setattr(module, "STEP_ROWS_MAX", 2)


@contextmanager
def opened(folder: Path, fault: Fails) -> Iterator[Store | None]:
    """A store on a disk that fails; None if that is told when it is opened."""
    with Disk(fault):
        try:
            store = Store(folder)
        except StoreError:
            yield None
            return
        try:
            yield store
        finally:
            with suppress(apsw.Error):  # SQLite itself does not mind, and copies the log when it is opened again
                store.close()


def used(store: Store) -> tuple[History, list[History], list[StoreError]]:
    """Do the steps. Return what was acknowledged; what it would be with each step that failed; and how they failed."""
    rng = np.random.default_rng(SEED)
    now, failed, refusals = [History()], [], []

    def may_be(histories: list[History]) -> None:
        now[:] = histories

    for _ in range(STEPS):
        try:
            now[0].step(rng).take(store, may_be)
        except StoreError as error:
            failed.append(now[-1])
            refusals.append(error)
            assert now[0].fault_in(store) == "", "reads go on, and see nothing of it"
    return now[0], failed, refusals


def every_place(
    folder: Path, kinds: tuple[str, ...], error: type[apsw.Error], extended: int, times: int = 1
) -> Iterator[tuple[Path, Fails]]:
    """Yield a run for each place where the disk may fail, until there is none: its folder, and the fault."""
    for at in range(1, OPERATIONS_MAX, 1 if kinds == ("sync",) else STRIDE):
        fault = Fails(at, kinds, error, extended, times)
        place = folder / str(at)
        yield place, fault
        shutil.rmtree(place)
        if not fault.happened:
            assert at > STEPS, "the run had hardly any operations"
            return
    raise AssertionError("the run does not end")


def restarted(folder: Path, possible: list[History]) -> None:
    """After a restart, on a disk that works, the store is one of these, answers as it did, and goes on."""
    rng = np.random.default_rng(SEED)
    with Disk(), closing(Store(folder)) as store:
        faults = [history.fault_in(store) or history.sent_again(store, rng) for history in possible]
        assert "" in faults, faults
        step = possible[faults.index("")].step(rng)
        step.take(store)
        assert not step.stages[-1].fault_in(store)


@pytest.mark.parametrize(
    ("kinds", "extended"),
    [(("sync",), apsw.SQLITE_IOERR_FSYNC), (("write", "truncate"), apsw.SQLITE_IOERR_WRITE)],
    ids=["sync", "write"],
)
def test_a_disk_that_fails_once_is_not_trusted_again(tmp_path, kinds, extended):
    """It works again at once. But what it lost it would not say a second time: nothing more is written."""
    stopped = 0
    for folder, fault in every_place(tmp_path, kinds, apsw.IOError, extended):
        possible = [History()]
        with opened(folder, fault) as store:
            if store:
                history, failed, refusals = used(store)
                possible = [history, *failed[:1]]
                stopped += len(refusals) > 1
                assert all("until a restart" in error.message for error in refusals[1:])
        restarted(folder, possible)
    assert stopped > 2


def test_a_disk_that_fails_before_the_end_of_a_long_transaction_is_not_trusted_again(tmp_path):
    """One that is larger than SQLite's memory begins the log, and syncs its beginning, long before the commit."""
    world = World(id="w", recipe=PLANE, recipe_name="plane", generator="0123")
    small, large = (
        Draft(epoch=world.epoch, digest=b"", strokes=bytes(size), stale=b"") for size in (1, EDIT_BYTES_MAX)
    )
    with closing(Store(tmp_path)) as store:
        store.catalogue.create(world)
    fails = Fails(1, ("sync",), apsw.IOError, apsw.SQLITE_IOERR_FSYNC)
    with Disk(fails), closing(Store(tmp_path)) as store:
        with pytest.raises(StoreError, match="a sync that fails"):
            store.log.append([large])
        with pytest.raises(StoreError, match="until a restart"):
            store.log.append([small])
        assert store.log.revision(world.epoch) == 0
    with closing(Store(tmp_path)) as store:
        assert store.log.append([small])[0] == (1, b"", False)


def test_a_disk_that_fails_while_somebody_reads(tmp_path):
    """The reader's connection is busy: what failed is told all the same."""
    reading, over = threading.Event(), threading.Event()

    def linger(*_: object) -> int:
        reading.set()
        return over.wait(SECONDS_MAX)

    def read(store: Store) -> bool:
        with store._database.read() as connection:
            connection.create_scalar_function("linger", linger)
            return bool(connection.execute("SELECT linger()").get)

    step = History().step(np.random.default_rng(SEED))
    with Disk(Fails(1, ("sync",), apsw.IOError, apsw.SQLITE_IOERR_FSYNC)) as disk:
        fault, disk.fault = disk.fault, lambda *_: None
        with closing(Store(tmp_path)) as store, ThreadPoolExecutor(1) as threads:
            lingering = threads.submit(read, store)
            try:
                assert reading.wait(SECONDS_MAX)
                disk.fault = fault
                for said in ("a sync that fails", "until a restart.*a sync that fails"):
                    with pytest.raises(StoreError, match=said):
                        step.take(store)
            finally:
                over.set()
            assert lingering.result(SECONDS_MAX)


def test_a_server_that_was_killed_starts_on_a_full_disk(tmp_path):
    """What it had written is synced, though there is no room to copy it into the file."""
    world = World(id="w", recipe=PLANE, recipe_name="plane", generator="0123")
    draft = Draft(epoch=world.epoch, digest=b"", strokes=b"x", stale=b"")
    done: list[tuple[str, str]] = []
    full = Fails(1, ("write",), apsw.FullError, apsw.SQLITE_FULL, OPERATIONS_MAX)

    def fault(kind: str, name: str) -> None:
        done.append((kind, name))
        full(kind, name)

    with closing(Store(tmp_path / "killed")) as store:
        store.catalogue.create(world)
        store.log.append([draft])
        shutil.copytree(tmp_path / "killed", tmp_path / "next")
    with Disk(fault), closing(Store(tmp_path / "next")) as store:
        assert done[:3] == [("sync", f"{FILE_NAME}-wal"), ("synced", f"{FILE_NAME}-wal"), ("write", FILE_NAME)]
        assert store.log.revision(world.epoch) == 1
        with pytest.raises(StoreFull):
            store.log.append([draft])
        full.times = 0
        assert store.log.append([draft]) == [(2, b"", False)]


@pytest.mark.parametrize("times", [1, 40])
def test_a_full_disk_refuses_and_goes_on_when_there_is_room(tmp_path, times, caplog):
    refused = went_on = 0
    for folder, fault in every_place(tmp_path, ("write",), apsw.FullError, apsw.SQLITE_FULL, times):
        possible = [History()]
        with opened(folder, fault) as store:
            if store:
                history, _, refusals = used(store)
                possible = [history]
                assert {type(error) for error in refusals} <= {StoreFull}
                refused += len(refusals)
                went_on += bool(refusals) and bool(history.logs)
        restarted(folder, possible)
    assert refused > 2
    assert went_on > 2
    assert "until a restart" not in caplog.text


def until_refused(store: Store, rng: np.random.Generator) -> tuple[History, str]:
    """Take steps until one is refused. Return what was acknowledged, and why the next was not."""
    now = [History()]

    def may_be(histories: list[History]) -> None:
        now[:] = histories

    for _ in range(STEPS):
        try:
            now[0].step(rng).take(store, may_be)
        except StoreError as error:
            return now[0], error.message
    return now[0], ""


def test_an_error_while_the_log_is_copied_into_the_file_stops_it_too(tmp_path):
    """SQLite does that behind a commit, and would keep the error to itself."""
    armed = False

    def fault(kind: str, name: str) -> None:
        if armed and (kind, name) == ("sync", FILE_NAME):
            error = apsw.IOError("a sync that fails")
            error.extendedresult = apsw.SQLITE_IOERR_FSYNC  # type: ignore[attr-defined] # SQLite is told this
            raise error

    rng = np.random.default_rng(SEED)
    with Disk(fault), closing(Store(tmp_path)) as store:
        armed = True
        history, refusal = until_refused(store, rng)
        assert "a sync that fails" in refusal
        armed = False
        with pytest.raises(StoreError, match="until a restart"):
            history.step(rng).take(store)
        assert history.fault_in(store) == ""
    restarted(tmp_path, [history])
