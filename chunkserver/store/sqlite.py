"""The file of worlds, opened safely: ours alone, known to be whole, and synced at every commit.

    Database(folder)    lock              held with flock while it is open, given back by the kernel
                        worlds.sqlite     SQLite with a write-ahead log, a sync for each commit

Two connections: one writes, a transaction at a time; the other reads what is committed, and never waits for a sync.
All that is known of SQLite's errors is here. Knows no HTTP and no asyncio.
"""

import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import apsw

from chunkserver.errors import StoreError, StoreFull
from chunkserver.store.schema import APPLICATION_ID, FORMAT, FORMATS
from chunkserver.store.seldom import Seldom
from chunkserver.store.turns import Turns

FILE_NAME: Final = "worlds.sqlite"
LOCK_NAME: Final = "lock"
BUSY_MS_MAX: Final = 5000
"""How long a write waits for somebody who looks into the file with another program."""
CHECKPOINT_PAGES: Final = 1000
"""Of the write-ahead log: from so many on they are copied into the file, before the next transaction."""
WAL_BYTES_KEPT: Final = 64 << 20
"""Of the write-ahead log: what is beyond that after a burst is given back to the disk."""

_IN_MEMORY: Final = ":memory:"
_SYNCHRONOUS_FULL: Final = 2

_log: Final = logging.getLogger(__name__)


class Database:
    """The file of worlds in `folder`, which is made if need be; in memory only, without a folder.

    Safe in any thread. A write that fails, but for want of room, leaves doubt about what the disk has: from then on
    nothing is written any more until a restart, while reads go on.

    folder: None if nothing is kept.
    path: of the file.

    Raises `StoreError` that names the folder if another server has it, or if it cannot be read or written; that names
    the file if it is damaged, of another program, or of a newer format.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.path = str(folder.absolute() / FILE_NAME) if folder else _IN_MEMORY
        self._writing = Turns()
        self._say_full, self._say_long = Seldom(_log, logging.ERROR), Seldom(_log, logging.WARNING)
        self._failed = ""
        self._wal_pages = 0
        with ExitStack() as held, _told(self.path, self._say_full):
            if folder:
                held.enter_context(locked(folder))
            self._writer = apsw.Connection(self.path)
            held.callback(self._writer.close)
            _prepare(self._writer, self.path)
            self._writer.set_wal_hook(self._count_pages)
            self._reader, self._reading = self._writer, self._writing
            if folder:
                self._reader, self._reading = _reader(self.path), Turns()
                held.callback(self._reader.close)
            self._held = held.pop_all()

    @contextmanager
    def write(self) -> Iterator[apsw.Connection]:
        """One transaction: when the block is left, the disk has all of it; after an error nothing of it was changed.

        Raises `StoreFull` if the disk is full, `StoreError` if it fails, or has failed before.
        """
        with self._writing, _told(self.path, self._say_full):
            self._check()
            self._checkpoint()
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield self._writer
            except apsw.IOError as error:  # a long transaction writes to the log, and syncs it, before its end
                self._stop(error)
                self._roll_back()
                raise
            except BaseException:
                self._roll_back()
                raise
            self._commit()

    @contextmanager
    def read(self) -> Iterator[apsw.Connection]:
        """What is committed, as of one moment. Keep it short: what is read is not given back to the disk meanwhile.

        Read each answer to its end, or close it: one that is left open keeps the moment, for the next reader too.

        Raises `StoreError`.
        """
        with self._reading, _told(self.path, self._say_full):
            self._reader.execute("BEGIN")
            try:
                yield self._reader
            finally:
                if self._reader.in_transaction:  # SQLite has ended it after some errors
                    self._reader.execute("ROLLBACK")

    def close(self) -> None:
        """Give the folder back. What was written is on the disk already."""
        with ExitStack() as turns:
            for turn in dict.fromkeys((self._writing, self._reading)):  # one, in memory
                turns.enter_context(turn)
            self._held.close()

    def _commit(self) -> None:
        try:
            self._writer.execute("COMMIT")
        except (apsw.FullError, apsw.BusyError):  # the write-ahead log has no end of this transaction: it never was
            self._roll_back()
            raise
        except apsw.Error as error:
            self._stop(error)
            self._roll_back()
            raise

    def _roll_back(self) -> None:
        if self._writer.in_transaction:  # SQLite has done it after some errors
            self._writer.execute("ROLLBACK")

    def _checkpoint(self) -> None:
        """Copy the write-ahead log into the file, if it is long. SQLite itself would not tell of an error."""
        if self._wal_pages < CHECKPOINT_PAGES:
            return
        try:
            self._writer.wal_checkpoint(mode=apsw.SQLITE_CHECKPOINT_PASSIVE)
            self._wal_pages = 0
        except (apsw.FullError, apsw.BusyError) as error:
            self._say_long("%s: the write-ahead log stays long: %s", self.path, error)
        except apsw.Error as error:
            self._stop(error)
            raise

    def _count_pages(self, _connection: apsw.Connection, _name: str, pages: int) -> int:
        self._wal_pages = pages
        return apsw.SQLITE_OK

    def _check(self) -> None:
        if self._failed:
            message = f"nothing is written until a restart, because a write failed: {self._failed}"
            raise StoreError(message, path=self.path)

    def _stop(self, error: apsw.Error) -> None:
        """Write no more. A sync that failed may have lost earlier writes, and the next one would not say so."""
        _log.critical("%s: nothing is written any more until a restart: %s", self.path, error)
        self._failed = str(error)
        self._writer.config(apsw.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1)  # it is closed last


@contextmanager
def _told(path: str, say_full: Seldom) -> Iterator[None]:
    """Turn what SQLite says into `StoreError`. Clients are told of a full disk, but not of our paths."""
    try:
        yield
    except apsw.FullError as error:
        say_full("%s: %s", path, error)
        raise StoreFull("the disk is full") from error
    except apsw.Error as error:
        raise StoreError(f"{path}: {error}", path=path) from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made if need be. It is given back on exec too: no child keeps it from the next.

    Raises `StoreError` if another server has it, or if it cannot be used.
    """
    try:
        _make_durable(folder)
        lock = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(f"{folder} cannot be used: {error}", folder=str(folder)) from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise StoreError(f"{folder} is in use: another server runs on it", folder=str(folder)) from error
        yield
    finally:
        os.close(lock)


def sync(path: Path) -> None:
    """Have on the disk what is in a file; of a folder, which files it has. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _make_durable(folder: Path) -> None:
    """Make the folder and those above it. A new one is lost with the power until the one above it is synced."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for path in missing:
        sync(path.parent)


def _reader(path: str) -> apsw.Connection:
    reader = apsw.Connection(path)
    reader.set_busy_timeout(BUSY_MS_MAX)
    reader.pragma("query_only", True)
    return reader


def _prepare(connection: apsw.Connection, path: str) -> None:
    """Bring a file to our format, after it has been found to be ours and whole. Only then is anything written."""
    connection.set_busy_timeout(BUSY_MS_MAX)
    found = _format(connection, path)
    _make_safe(connection, path)
    _sync_what_was_left(connection, path)
    if found == FORMAT:
        return
    connection.execute("BEGIN IMMEDIATE")
    for statements in FORMATS[found:]:
        connection.execute(statements)
    connection.pragma("application_id", APPLICATION_ID)
    connection.pragma("user_version", FORMAT)
    connection.execute("COMMIT")


def _sync_what_was_left(connection: apsw.Connection, path: str) -> None:
    """Have on the disk what a server that was killed had written, but not synced. SQLite takes it for committed."""
    try:
        connection.wal_checkpoint(mode=apsw.SQLITE_CHECKPOINT_TRUNCATE)
    except apsw.FullError as error:  # the log is synced before it is copied: it is safe, and stays long
        _log.warning("%s: the write-ahead log stays long: %s", path, error)


def _format(connection: apsw.Connection, path: str) -> int:
    """Return the format of the file, 0 if it is empty. Raises `StoreError` if it is damaged, not ours, or newer."""
    application, version = connection.pragma("application_id"), connection.pragma("user_version")
    tables = connection.execute("SELECT count(*) FROM sqlite_schema").get
    if (application, version, tables) == (0, 0, 0):
        return 0
    if application != APPLICATION_ID:
        raise StoreError(f"{path} is no file of worlds: another program has made it", path=path)
    if version > FORMAT:
        message = f"{path} has format {version}; this version of chunkserver reads {FORMAT}: use a newer one"
        raise StoreError(message, path=path, format=version)
    verdict = connection.pragma("integrity_check", 1)
    if verdict != "ok":
        raise StoreError(f"{path} is damaged: {verdict}", path=path)
    return int(version)


def _make_safe(connection: apsw.Connection, path: str) -> None:
    """Have every commit synced before it is answered. Raises `StoreError` if it cannot be had."""
    journal = connection.pragma("journal_mode", "wal")
    connection.pragma("synchronous", "full")
    connection.pragma("journal_size_limit", WAL_BYTES_KEPT)
    if path != _IN_MEMORY and (journal, connection.pragma("synchronous")) != ("wal", _SYNCHRONOUS_FULL):
        raise StoreError(f"{path}: journal_mode is {journal!r}; it must be 'wal', with synchronous = FULL", path=path)
