"""What was made of a world's edits, kept so that a start need not make all of it again.

    Snapshots(folder)    bricks.sqlite    SQLite with a write-ahead log, not synced at each commit

It may be lost at any time: then it is made again from the log. It is never wrong: a part that is not what was put in
makes the file go. Delete it whenever `worlds.sqlite` is put back from a copy.
"""

import logging
import threading
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import apsw

FILE_NAME: Final = "bricks.sqlite"
APPLICATION_ID: Final = 0x43484E42
FORMAT: Final = 1
"""A file of another format is deleted, older or newer."""
BUSY_MS_MAX: Final = 1000
WAL_BYTES_KEPT: Final = 64 << 20
"""Of the write-ahead log, after a transaction that had more."""

_IN_MEMORY: Final = ":memory:"
_SUFFIXES: Final = ("", "-wal", "-shm", "-journal")
_SCHEMA: Final = f"""
BEGIN;
CREATE TABLE snapshots (
    epoch TEXT PRIMARY KEY, generator TEXT NOT NULL, revision INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE parts (
    epoch TEXT NOT NULL, name BLOB NOT NULL, checksum INTEGER NOT NULL, content BLOB NOT NULL, UNIQUE (epoch, name)
) STRICT;
CREATE TRIGGER snapshot_goes AFTER DELETE ON snapshots BEGIN DELETE FROM parts WHERE epoch = old.epoch; END;
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FORMAT};
COMMIT;
"""

# No REPLACE: it deletes first, and its trigger would take the parts away.
_HEAD: Final = """
INSERT INTO snapshots (epoch, generator, revision) VALUES (?, ?, ?)
ON CONFLICT (epoch) DO UPDATE SET generator = excluded.generator, revision = excluded.revision
"""

_Result = TypeVar("_Result")
_log: Final = logging.getLogger(__name__)


class Snapshot(NamedTuple):
    """What the edits up to `revision` have made, in named parts."""

    revision: int
    parts: Mapping[bytes, bytes]


class Snapshots:
    """One snapshot of each world, in `folder`; in memory only, without a folder. The file is opened when it is needed.

    Safe in any thread. Nothing here raises for a disk that fails: what is lost is made again, and the log says why.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._path = folder.absolute() / FILE_NAME if folder else None
        self._lock = threading.Lock()
        self._connection: apsw.Connection | None = None

    def load(self, epoch: str, generator: str) -> Snapshot | None:
        """Return the snapshot of a world, or None: there is none, or another generator made it.

        In a folder it does not wait while another one is put.
        """
        if self._path and self._path.exists():
            with suppress(apsw.Error), closing(_opened(self._path)) as connection:
                return _load(connection, epoch, generator)
        return self._attempt(lambda connection: _load(connection, epoch, generator))

    def put(
        self,
        epoch: str,
        generator: str,
        revision: int,
        changed: Iterable[tuple[bytes, bytes]],
        removed: Iterable[bytes] = (),
        since: int | None = None,
    ) -> bool:
        """Change the snapshot of a world to that of `revision`, in one transaction.

        changed: parts that are new or other than at `since`, names and contents.
        removed: names of parts that were there at `since`, and are no more.
        since: the revision of the snapshot that is changed; None: `changed` is all there is.

        Both are taken as they are written; meanwhile others that put or drop have to wait. What they raise is raised,
        and nothing has changed then, but for `apsw.Error` and OSError.

        Returns whether it was kept. If not, what is there is not of `since`, or is lost: put all of it.
        """
        rows = ((epoch, name, zlib.crc32(content), content) for name, content in changed)
        gone = ((epoch, name) for name in removed)

        def change(connection: apsw.Connection) -> bool:
            with connection:
                if since is None:
                    connection.execute("DELETE FROM snapshots WHERE epoch = ?", (epoch,))
                elif (generator, since) != _head(connection, epoch):
                    return False
                connection.executemany("DELETE FROM parts WHERE epoch = ? AND name = ?", gone)
                connection.executemany("REPLACE INTO parts (epoch, name, checksum, content) VALUES (?, ?, ?, ?)", rows)
                connection.execute(_HEAD, (epoch, generator, revision))
            return True

        return bool(self._attempt(change))

    def drop(self, *epochs: str) -> None:
        """Drop the snapshots of worlds that are gone."""

        def drop(connection: apsw.Connection) -> None:
            with connection:
                connection.executemany("DELETE FROM snapshots WHERE epoch = ?", [(epoch,) for epoch in epochs])

        self._attempt(drop)

    def keep(self, epochs: Iterable[str]) -> None:
        """Drop the snapshots of all other worlds."""
        kept = set(epochs)
        found = self._attempt(
            lambda connection: [epoch for (epoch,) in connection.execute("SELECT epoch FROM snapshots")]
        )
        self.drop(*(epoch for epoch in found or () if epoch not in kept))

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._release()

    def _attempt(self, action: Callable[[apsw.Connection], _Result]) -> _Result | None:
        """Return what `action` returns. None if the file cannot be used; if it is damaged, it is deleted."""
        with self._lock:
            try:
                self._connection = self._connection or _opened(self._path)
                return action(self._connection)
            except (apsw.CorruptError, apsw.NotADBError) as error:
                self._discard(error)
            except (apsw.Error, OSError) as error:
                _log.warning("%s: a snapshot of edits was not kept or not found: %s", self._path, error)
            return None

    def _discard(self, error: Exception) -> None:
        _log.warning("%s is damaged and is made again: %s", self._path, error)
        self._release()
        if self._path:
            _delete(self._path)

    def _release(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def _delete(path: Path) -> None:
    for suffix in _SUFFIXES:
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _opened(path: Path | None) -> apsw.Connection:
    connection = apsw.Connection(str(path or _IN_MEMORY))
    connection.set_busy_timeout(BUSY_MS_MAX)
    found = (connection.pragma("application_id"), connection.pragma("user_version"))
    if found == (APPLICATION_ID, FORMAT):
        pass
    elif connection.execute("SELECT count(*) FROM sqlite_schema").get:
        connection.close()
        raise apsw.NotADBError(f"application and format are {found}")
    connection.pragma("journal_mode", "wal")
    connection.pragma("journal_size_limit", WAL_BYTES_KEPT)
    connection.pragma("synchronous", "normal")  # whole after a loss of power, though perhaps not the newest
    if found != (APPLICATION_ID, FORMAT):
        connection.execute(_SCHEMA)
    return connection


def _head(connection: apsw.Connection, epoch: str) -> tuple[str, int] | None:
    for generator, revision in connection.execute(
        "SELECT generator, revision FROM snapshots WHERE epoch = ?", (epoch,)
    ):
        return generator, revision
    return None


def _load(connection: apsw.Connection, epoch: str, generator: str) -> Snapshot | None:
    head = _head(connection, epoch)
    if head is None or head[0] != generator:
        return None
    parts: dict[bytes, bytes] = {}
    query = "SELECT name, checksum, content FROM parts WHERE epoch = ? ORDER BY name"
    for name, checksum, content in connection.execute(query, (epoch,)):
        if zlib.crc32(content) != checksum:
            raise apsw.CorruptError(f"a part of {epoch} is not what was put in")
        parts[name] = content
    return Snapshot(head[1], parts)
