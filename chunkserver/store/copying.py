"""The file of worlds, copied: as of one moment, while a server writes to it; and put back into a folder.

What is put back is not what clients have seen since, so its worlds get new epochs.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import product
from pathlib import Path
from typing import Final

import apsw

from chunkserver.errors import StoreError
from chunkserver.store import snapshots
from chunkserver.store.catalogue import Catalogue
from chunkserver.store.schema import APPLICATION_ID
from chunkserver.store.sqlite import BUSY_MS_MAX, FILE_NAME, Database, locked, sync
from chunkserver.world import World

STAGING_NAME: Final = "restoring"
"""A folder within the one that is restored, in which a copy is made ready."""

SUFFIXES: Final = ("", "-wal", "-shm", "-journal")
"""Of the files that SQLite keeps for one database."""


def back_up(folder: Path, copy: Path) -> None:
    """Write a copy of the worlds of a folder, and of the logs of their edits: one file. A server may use the folder.

    Raises `StoreError` if the folder holds no worlds, if there is a file of that name, or if one cannot be written.
    Then there is none.
    """
    _check_there(folder / FILE_NAME)
    if copy.exists():
        raise StoreError(f"{copy} is there already", path=str(copy))
    beside = copy.with_name(f".{copy.name}.{os.getpid()}.part")
    with _told(copy):
        try:
            _copy(folder / FILE_NAME, beside)
            beside.replace(copy)
            sync(copy.absolute().parent)
        finally:
            beside.unlink(missing_ok=True)


def restore(copy: Path, folder: Path) -> list[World]:
    """Put a copy into a folder that holds no worlds. Return its worlds: each has a new epoch.

    Raises `StoreError` if the folder holds worlds, or if the copy is none that can be read. Then it still holds none.
    """
    _check_there(copy)
    with _told(copy), locked(folder):
        if (folder / FILE_NAME).exists():
            raise StoreError(f"{folder} holds worlds already: move them away, or take another folder", path=str(folder))
        with _emptied(folder / STAGING_NAME) as staging:
            _copy(copy, staging / FILE_NAME)
            with closing(Database(staging)) as database:
                worlds = Catalogue(database).renew()
            sync(staging / FILE_NAME)
            for name, suffix in product((FILE_NAME, snapshots.FILE_NAME), SUFFIXES):  # of worlds that were moved away
                (folder / f"{name}{suffix}").unlink(missing_ok=True)
            (staging / FILE_NAME).replace(folder / FILE_NAME)
            sync(folder)
        return worlds


@contextmanager
def _emptied(folder: Path) -> Iterator[Path]:
    """A folder without anything in it, which is there for a while."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _check_there(file: Path) -> None:
    if not file.is_file():
        raise StoreError(f"there is no file {file}", path=str(file))


def _copy(source: Path, target: Path) -> None:
    """Copy a database, with what its write-ahead log has, into a new file that needs none."""
    flags = apsw.SQLITE_OPEN_READWRITE  # which SQLite takes for reading, where nothing can be written
    with closing(apsw.Connection(str(source), flags=flags)) as old, closing(apsw.Connection(str(target))) as new:
        if old.pragma("application_id") != APPLICATION_ID:
            raise StoreError(f"{source} is no file of worlds: another program has made it", path=str(source))
        old.config(apsw.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1)
        old.set_busy_timeout(BUSY_MS_MAX)
        with new.backup("main", old, "main") as backup:
            backup.step()  # all at once: one that is written to between two steps would begin again
        new.pragma("journal_mode", "delete")
    sync(target)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except (apsw.CorruptError, apsw.NotADBError) as error:
        raise StoreError(f"{path} cannot be copied: it is damaged, or no file of worlds", path=str(path)) from error
    except (apsw.Error, OSError) as error:
        raise StoreError(f"{path} cannot be copied: {error}", path=str(path)) from error
