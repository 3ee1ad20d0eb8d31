"""The file of worlds: whose it is, whether it is whole, and that it keeps its promise."""

import subprocess
import sys
from unittest import mock

import apsw
import pytest

from chunkserver.errors import StoreError
from chunkserver.store import Store
from chunkserver.store.schema import APPLICATION_ID, FORMAT
from chunkserver.store.sqlite import FILE_NAME, LOCK_NAME
from tests.unit.store.worlds import edited, refused, world


def test_it_is_durable_before_it_answers(folder):
    """Another connection sees it, and the file is synced: SQLite says how it commits."""
    kept = Store(folder)
    kept.catalogue.create(world())
    connection = apsw.Connection(str(folder / FILE_NAME), flags=apsw.SQLITE_OPEN_READONLY)
    assert connection.pragma("journal_mode") == "wal"
    assert connection.execute("SELECT id FROM worlds").get == "a"
    assert kept._database._writer.pragma("synchronous") == 2
    connection.close()
    kept.close()


@pytest.mark.parametrize("answer", ["delete", "memory"])
def test_a_disk_that_cannot_keep_its_promise_is_refused(folder, answer):
    class Careless(apsw.Connection):
        def pragma(self, name, *values, **options):
            return answer if name == "journal_mode" else super().pragma(name, *values, **options)

    with (
        mock.patch.object(apsw, "Connection", Careless),
        pytest.raises(StoreError, match=f"journal_mode is '{answer}'"),
    ):
        Store(folder)


def test_the_folder_has_one_server(folder):
    first = Store(folder)
    with pytest.raises(StoreError, match=rf"{folder} is in use"):
        Store(folder)
    with pytest.raises(StoreError, match="is in use"):
        Store(folder / ".." / folder.name)
    first.close()
    Store(folder).close()


def test_a_child_does_not_hold_the_folder(folder):
    first = Store(folder)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, close_fds=False)
    try:
        first.close()
        Store(folder).close()
    finally:
        child.communicate(b"\n")


def test_the_folder_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be used"):
        Store(tmp_path / "file" / "folder")


def test_a_newer_format_is_refused(folder):
    Store(folder).close()
    edited(folder, f"PRAGMA user_version = {FORMAT + 1}")
    refused(folder, f"format {FORMAT + 1}", "use a newer one")


def test_the_file_of_another_program_is_refused(folder):
    folder.mkdir(parents=True)
    edited(folder, "CREATE TABLE worlds (id TEXT)")
    refused(folder, "another program")
    edited(folder, f"PRAGMA application_id = {APPLICATION_ID + 1}", f"PRAGMA user_version = {FORMAT}")
    refused(folder, "another program")
    (folder / FILE_NAME).write_bytes(b"no database at all" * 1000)
    refused(folder, "not a database")


def test_a_torn_file_is_refused(folder):
    kept = Store(folder)
    for number in range(200):
        kept.catalogue.create(world(f"w{number}"))
    kept.close()
    whole = (folder / FILE_NAME).read_bytes()
    page = int.from_bytes(whole[16:18], "big")
    for cut in (page, len(whole) // page // 2 * page, len(whole) - page):
        (folder / FILE_NAME).write_bytes(whole[:cut])
        refused(folder, "malformed")
    (folder / FILE_NAME).write_bytes(whole[: 2 * page] + bytes(page) + whole[3 * page :])
    refused(folder)
    (folder / FILE_NAME).write_bytes(whole.replace(b"w150", b"zzzz"))
    refused(folder, "damaged", "order")
    (folder / FILE_NAME).write_bytes(whole)
    assert len(Store(folder).catalogue) == 200


def test_a_file_that_was_begun_only_is_a_new_one(folder):
    folder.mkdir(parents=True)
    (folder / FILE_NAME).touch()
    Store(folder).close()
    (folder / FILE_NAME).unlink()
    edited(folder, "PRAGMA journal_mode = wal")
    kept = Store(folder)
    kept.catalogue.create(world())
    kept.close()


def test_the_lock_is_a_file_of_its_own(folder):
    kept = Store(folder)
    assert {path.name for path in folder.iterdir()} >= {FILE_NAME, LOCK_NAME}
    assert not (folder / LOCK_NAME).read_bytes()
    kept.close()
    assert {path.name for path in folder.iterdir()} == {FILE_NAME, LOCK_NAME}
