import os
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import apsw
import pytest

from chunkserver.errors import StoreError
from chunkserver.store import Store, copying, snapshots
from chunkserver.store.sqlite import FILE_NAME
from tests.unit.store.edits import A, B, bodies, draft, written

SECONDS_MAX = 60.0


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "folder"


def filled(folder):
    """Keep two worlds, one of them edited."""
    with closing(Store(folder)) as kept:
        kept.catalogue.create(A)
        kept.catalogue.create(B)
        written(kept.log, draft(b"1", key="k"), draft(b"2", client="c", seq=7))


def check(folder, worlds):
    """Whether a folder has what `filled` has kept, under other epochs."""
    first, second = worlds
    assert (first.id, first.revision, second.id, second.revision) == ("a", 2, "b", 0)
    assert not {first.epoch, second.epoch} & {A.epoch, B.epoch}
    with closing(Store(folder)) as kept:
        assert [kept.catalogue.find(name) for name in ("a", "b")] == worlds
        assert bodies(kept.log, first.epoch) == [(1, b"1"), (2, b"2")]
        assert bodies(kept.log, second.epoch) == []
        again = written(kept.log, draft(b"1", first.epoch, key="k"), draft(b"2", first.epoch, client="c", seq=7))
        assert [(one.revision, one.duplicate) for one in again] == [(1, True), (2, True)], "keys and seqs stay known"


def test_what_was_backed_up_is_restored_with_new_epochs(folder, tmp_path):
    filled(folder)
    copy = tmp_path / "copy"
    Store.back_up(folder, copy)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([folder.name, "copy"])
    worlds = Store.restore(copy, tmp_path / "new")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["lock", FILE_NAME]
    check(tmp_path / "new", worlds)
    assert {world.epoch for world in Store.restore(copy, tmp_path / "newer")}.isdisjoint(
        world.epoch for world in worlds
    )
    with closing(Store(folder)) as kept:
        assert [kept.catalogue.find(name) for name in ("a", "b")] == [replace(A, revision=2), B], (
            "they are as they were"
        )


def test_a_copy_is_taken_while_another_process_writes(folder, tmp_path):
    """All of it is as of one moment: the log has no hole, and nobody has to stop."""
    filled(folder)
    code = f"""
import sys
from pathlib import Path
from chunkserver.store import Store
Store.back_up(Path({str(folder)!r}), Path(sys.argv[1]))
"""
    kept, stop = Store(folder), threading.Event()
    try:
        kept.catalogue.delete("b")
        writing = threading.Thread(
            target=lambda: [written(kept.log, draft(b"x" * 5000)) for _ in iter(stop.is_set, True)]
        )
        writing.start()
        for number in range(2):
            command = [sys.executable, "-c", code, str(tmp_path / str(number))]
            subprocess.run(command, check=True, timeout=SECONDS_MAX, env=os.environ)
        before = kept.log.revision(A.epoch)
    finally:
        stop.set()
        writing.join(SECONDS_MAX)
        kept.close()
    revisions = []
    for number in range(2):
        (world,) = Store.restore(tmp_path / str(number), tmp_path / f"new{number}")
        revisions.append(world.revision)
        with closing(apsw.Connection(str(tmp_path / f"new{number}" / FILE_NAME))) as again:
            found = again.execute("SELECT count(*), max(revision) FROM edits WHERE world = 1").get
        assert found == (world.revision, world.revision)
    assert 2 < revisions[0] < revisions[1] <= before


def test_a_plain_copy_with_its_write_ahead_log_is_restored_too(folder, tmp_path):
    with closing(Store(folder)) as kept:
        kept.catalogue.create(A)
        kept.catalogue.create(B)
        written(kept.log, draft(b"1", key="k"), draft(b"2", client="c", seq=7))
        copied = tmp_path / "copied"
        copied.mkdir()
        for name in (FILE_NAME, f"{FILE_NAME}-wal"):
            (copied / name).write_bytes((folder / name).read_bytes())
    check(tmp_path / "new", Store.restore(copied / FILE_NAME, tmp_path / "new"))


def test_what_was_left_beside_worlds_that_are_gone_is_not_taken_for_theirs(folder, tmp_path):
    filled(folder)
    Store.back_up(folder, tmp_path / "copy")
    new = tmp_path / "new"
    new.mkdir()
    for name in (
        f"{FILE_NAME}-wal",
        f"{FILE_NAME}-shm",
        snapshots.FILE_NAME,
        f"{snapshots.FILE_NAME}-wal",
        "mine.sqlite",
    ):
        (new / name).write_bytes(b"left")
    (new / copying.STAGING_NAME).mkdir()
    (new / copying.STAGING_NAME / FILE_NAME).write_bytes(b"left")
    check(new, Store.restore(tmp_path / "copy", new))
    assert sorted(path.name for path in new.iterdir()) == ["lock", "mine.sqlite", FILE_NAME]


def test_a_folder_that_holds_worlds_keeps_them(folder, tmp_path):
    filled(folder)
    Store.back_up(folder, tmp_path / "copy")
    before = (folder / FILE_NAME).read_bytes()
    with pytest.raises(StoreError, match="holds worlds already"):
        Store.restore(tmp_path / "copy", folder)
    with closing(Store(folder)), pytest.raises(StoreError, match="another server runs on it"):
        Store.restore(tmp_path / "copy", folder)
    assert (folder / FILE_NAME).read_bytes() == before


def test_a_file_that_is_there_is_not_written_over(folder, tmp_path):
    filled(folder)
    (tmp_path / "copy").write_bytes(b"mine")
    with pytest.raises(StoreError, match="copy is there already"):
        Store.back_up(folder, tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == b"mine"
    with pytest.raises(StoreError, match="there is no file"):
        Store.back_up(tmp_path / "none", tmp_path / "other")
    with pytest.raises(StoreError, match="cannot be copied"):
        Store.back_up(folder, tmp_path / "none" / "copy")


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def holed(content: bytes) -> bytes:
    return content[:8192] + bytes(8192) + content[16384:]


@pytest.mark.parametrize("damage", [cut, holed, lambda _: b"", lambda _: b"no database at all" * 999])
def test_a_copy_that_is_damaged_is_refused(folder, tmp_path, damage):
    filled(folder)
    Store.back_up(folder, tmp_path / "copy")
    (tmp_path / "copy").write_bytes(damage((tmp_path / "copy").read_bytes()))
    with pytest.raises(StoreError):
        Store.restore(tmp_path / "copy", tmp_path / "new")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["lock"]


def test_a_file_of_another_program_is_refused(tmp_path):
    apsw.Connection(str(tmp_path / "other")).execute("CREATE TABLE t (a)")
    with pytest.raises(StoreError, match="no file of worlds"):
        Store.restore(tmp_path / "other", tmp_path / "new")
    with pytest.raises(StoreError, match="there is no file"):
        Store.restore(tmp_path / "none", tmp_path / "newer")
    assert not (tmp_path / "newer").exists()


@pytest.mark.parametrize("step", ["_copy", "Database", "Catalogue", "sync"])
def test_what_ends_early_leaves_no_worlds(folder, tmp_path, monkeypatch, step):
    filled(folder)
    Store.back_up(folder, tmp_path / "copy")

    def end(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(copying, step, end)
        with pytest.raises(StoreError, match="No space left"):
            Store.restore(tmp_path / "copy", tmp_path / "new")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["lock"]
    check(tmp_path / "new", Store.restore(tmp_path / "copy", tmp_path / "new"))


def test_a_copy_that_ends_early_leaves_no_file(folder, tmp_path, monkeypatch):
    filled(folder)

    def end(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", end)
    with pytest.raises(StoreError, match="No space left"):
        Store.back_up(folder, tmp_path / "copy")
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


def test_a_log_that_is_prepared_is_found_when_its_world_is_created(folder):
    with closing(Store(folder)) as kept:
        kept.catalogue.prepare(A.epoch)
        written(kept.log, draft(b"1"))
        assert kept.catalogue.find("a") is None
        assert len(kept.catalogue) == 0
        kept.catalogue.create(A)
        written(kept.log, draft(b"2"))
        assert bodies(kept.log) == [(1, b"1"), (2, b"2")]
    with closing(Store(folder)) as kept:
        assert kept.log.revision(A.epoch) == 2


def test_a_log_whose_world_never_came_is_gone_after_a_restart(folder):
    with closing(Store(folder)) as kept:
        kept.catalogue.create(B)
        kept.catalogue.prepare(A.epoch)
        written(kept.log, draft(b"1"), draft(b"1", B.epoch))
    with closing(Store(folder)) as kept:
        with pytest.raises(StoreError, match="no world of epoch"):
            kept.log.revision(A.epoch)
        assert kept.log.revision(B.epoch) == 1
        kept.catalogue.create(A)
        assert kept.log.revision(A.epoch) == 0
