"""A file of an older format is brought to ours when it is opened: all of it, or nothing."""

from contextlib import closing

import apsw
import pytest

from chunkserver.errors import StoreError
from chunkserver.store import Draft, Store, schema, sqlite
from chunkserver.store.schema import APPLICATION_ID, FORMAT, FORMATS
from chunkserver.store.sqlite import FILE_NAME
from tests.unit.store.worlds import TERRAIN

# As format 1 was written, not as it stands in the code today.
FORMAT_1 = f"""
PRAGMA journal_mode = wal;
CREATE TABLE worlds (
    id TEXT PRIMARY KEY, epoch TEXT NOT NULL, seed INTEGER NOT NULL, source TEXT NOT NULL, recipe_name TEXT NOT NULL,
    voxel_size REAL NOT NULL, lods INTEGER NOT NULL, chunk_cells INTEGER NOT NULL, generator TEXT NOT NULL,
    created TEXT NOT NULL
) STRICT, WITHOUT ROWID;
PRAGMA application_id = {0x43484E4B};
PRAGMA user_version = 1;
"""
ROW = "INSERT INTO worlds VALUES (?, ?, 42, ?, 'terrain', 1.0, 12, 32, '0123', '2026-01-31T12:00:00Z')"


@pytest.fixture
def old(folder):
    """The file of a server that knew no edits, with two worlds."""
    folder.mkdir(parents=True)
    with closing(apsw.Connection(str(folder / FILE_NAME))) as connection:
        connection.execute(FORMAT_1).fetchall()
        connection.executemany(ROW, [("b", "e2", TERRAIN), ("a", "e1", TERRAIN)])
    return folder


def test_a_file_of_format_1_gets_a_log(old):
    draft = Draft(epoch="e1", digest=b"d", strokes=b"s", stale=b"")
    with closing(Store(old)) as store:
        worlds = store.catalogue.page("", 9)
        assert [(world.id, world.epoch, world.recipe.seed, world.revision) for world in worlds] == [
            ("a", "e1", 42, 0),
            ("b", "e2", 42, 0),
        ]
        assert store.log.append([draft]) == [(1, b"", False)]
        store.catalogue.delete("b")
    with closing(Store(old)) as again:
        assert again.log.revision("e1") == 1
    with closing(apsw.Connection(str(old / FILE_NAME))) as connection:
        assert (connection.pragma("user_version"), connection.pragma("application_id")) == (FORMAT, APPLICATION_ID)


def test_an_upgrade_that_fails_changes_nothing(old, monkeypatch):
    broken = (*FORMATS, "CREATE TABLE more (x); CREATE TABLE worlds (x);")
    monkeypatch.setattr(sqlite, "FORMATS", broken)
    monkeypatch.setattr(sqlite, "FORMAT", len(broken))
    with pytest.raises(StoreError, match="table worlds already exists"):
        Store(old)
    with closing(apsw.Connection(str(old / FILE_NAME))) as connection:
        assert connection.pragma("user_version") == 1
        assert connection.execute("SELECT count(*) FROM sqlite_schema WHERE type = 'table'").get == 1
    monkeypatch.undo()
    with closing(Store(old)) as store:
        assert len(store.catalogue) == 2


def test_an_upgraded_file_is_what_a_new_one_is(old, tmp_path):
    def schema_of(folder):
        with closing(Store(folder)):
            pass
        with closing(apsw.Connection(str(folder / FILE_NAME))) as connection:
            return set(connection.execute("SELECT type, name, sql FROM sqlite_schema"))

    assert schema_of(old) == schema_of(tmp_path / "fresh")


def test_formats_are_only_ever_added():
    """What is on somebody's disk cannot be changed any more; a change is another format."""
    with closing(apsw.Connection("")) as connection:
        connection.execute(schema.FORMATS[0])
        written = set(connection.execute("SELECT type, name, sql FROM sqlite_schema"))
    with closing(apsw.Connection("")) as connection:
        connection.execute(FORMAT_1).fetchall()
        assert set(connection.execute("SELECT type, name, sql FROM sqlite_schema")) == written
