from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import apsw
import pytest

from chunkserver.store import snapshots
from chunkserver.store.snapshots import APPLICATION_ID, FILE_NAME, FORMAT, Snapshots

PARTS = {b"brick 1": bytes(5000), b"brick 2": b"b", b"chunks": b""}


@pytest.fixture(params=["file", "memory"])
def kept(request, tmp_path):
    with closing(Snapshots(tmp_path if request.param == "file" else None)) as snapshots:
        yield snapshots


def test_what_was_put_is_loaded(kept):
    assert kept.load("e", "g") is None
    assert kept.put("e", "g", 7, PARTS.items())
    assert kept.put("other", "g", 1, {b"brick 1": b"another world's"}.items())
    assert kept.load("e", "g") == (7, PARTS)
    assert kept.load("e", "another") is None
    assert kept.load("nobody", "g") is None


def test_a_snapshot_is_changed_from_the_one_before(kept):
    kept.put("e", "g", 7, PARTS.items())
    assert kept.put("e", "g", 9, {b"brick 1": b"new", b"brick 3": b"c"}.items(), [b"brick 2"], since=7)
    changed = {b"brick 1": b"new", b"brick 3": b"c", b"chunks": b""}
    assert kept.load("e", "g") == (9, changed)
    assert not kept.put("e", "g", 10, {b"brick 1": b"x"}.items(), since=8), "changes since something else"
    assert not kept.put("e", "another", 10, {b"brick 1": b"x"}.items(), since=9)
    assert not kept.put("nobody", "g", 10, {b"brick 1": b"x"}.items(), since=9)
    assert kept.load("e", "g") == (9, changed)
    assert kept.put("e", "another", 3, {b"all": b"x"}.items())
    assert (kept.load("e", "another"), kept.load("e", "g")) == ((3, {b"all": b"x"}), None)


def test_what_raises_while_it_is_put_changes_nothing(kept):
    kept.put("e", "g", 7, PARTS.items())

    def failing():
        yield b"brick 1", b"new"
        raise MemoryError

    for since in (7, None):
        with pytest.raises(MemoryError):
            kept.put("e", "g", 8, failing(), [b"brick 2"], since)
        assert kept.load("e", "g") == (7, PARTS)
    assert kept.put("e", "g", 8, {}.items(), [b"brick 2"], 7), "the next one goes on"


def test_nobody_waits_to_load_while_another_one_is_put(tmp_path):
    with closing(Snapshots(tmp_path)) as kept, ThreadPoolExecutor(1) as thread:
        kept.put("e", "g", 7, PARTS.items())

        def slow():
            yield b"brick 3", b"c"
            loaded.append(thread.submit(kept.load, "e", "g").result(10))

        loaded: list[object] = []
        assert kept.put("other", "g", 1, slow())
        assert kept.put("e", "g", 8, slow(), since=7)
        assert loaded == [(7, PARTS), (7, PARTS)], "as it was, until all of it is there"
        assert kept.load("e", "g") == (8, {**PARTS, b"brick 3": b"c"})


def test_worlds_that_are_gone_are_dropped(kept):
    for epoch in ("a", "b", "c"):
        kept.put(epoch, "g", 1, PARTS.items())
    kept.keep(["b", "new"])
    assert [epoch for epoch in ("a", "b", "c") if kept.load(epoch, "g")] == ["b"]
    assert kept._connection.execute("SELECT count(*) FROM parts").get == len(PARTS)


def test_they_outlive_a_restart(tmp_path):
    with closing(Snapshots(tmp_path)) as first:
        first.put("e", "g", 7, PARTS.items())
    with closing(Snapshots(tmp_path)) as second:
        assert second.load("e", "g") == (7, PARTS)


def lose(path):
    path.unlink()


def tear(path):
    path.write_bytes(path.read_bytes()[:5000])


def scribble(path):
    path.write_bytes(bytes(100_000))


def rot(path):
    """One bit of a part, which no checksum of SQLite's covers."""
    with closing(apsw.Connection(str(path))) as connection:
        connection.execute("UPDATE parts SET content = x'63' WHERE name = ?", (b"brick 2",))


def renew(path):
    with closing(apsw.Connection(str(path))) as connection:
        connection.pragma("user_version", FORMAT + 1)


def replace(path):
    path.unlink()
    with closing(apsw.Connection(str(path))) as connection:
        connection.execute(f"CREATE TABLE snapshots (x); PRAGMA application_id = {APPLICATION_ID + 1}")


@pytest.mark.parametrize("harm", [lose, tear, scribble, rot, renew, replace])
def test_a_damaged_file_is_made_again(tmp_path, harm):
    with closing(Snapshots(tmp_path)) as first:
        first.put("e", "g", 7, PARTS.items())
    harm(tmp_path / FILE_NAME)
    with closing(Snapshots(tmp_path)) as second:
        assert second.load("e", "g") is None
        assert not second.put("e", "g", 8, {}.items(), since=7), "what it would change is not there"
        assert second.put("e", "g", 8, PARTS.items())
        assert second.load("e", "g") == (8, PARTS)


def test_the_write_ahead_log_does_not_stay_as_long_as_it_once_was(tmp_path, monkeypatch):
    monkeypatch.setattr(snapshots, "WAL_BYTES_KEPT", 1 << 20)
    with closing(Snapshots(tmp_path)) as kept:
        kept.put("e", "g", 1, [(bytes([number]), bytes(1 << 18)) for number in range(32)])
        for revision in (2, 3):
            kept.put("e", "g", revision, [(b"x", b"x")], since=revision - 1)
        assert (tmp_path / f"{FILE_NAME}-wal").stat().st_size <= 1 << 20


def test_a_disk_that_fails_harms_nobody(tmp_path, caplog):
    kept = Snapshots(tmp_path / "nowhere")
    assert kept.load("e", "g") is None
    assert not kept.put("e", "g", 7, PARTS.items())
    kept.keep([])
    kept.close()
    assert {record.levelname for record in caplog.records} == {"WARNING"}
