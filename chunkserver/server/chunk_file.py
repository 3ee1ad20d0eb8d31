"""The file of the disk cache: LMDB's, of bounded size, in a folder that one server owns. Nothing else knows LMDB.

    folder/chunks.lock    flock; not empty while a server runs, nor after one that was killed
           chunks-2.mdb   format 2: `chunks` by key, and `order`, their keys by when they were written

The oldest written go first. A read then never writes, freed pages lie side by side, and what is wanted again costs one
build in a turn of the whole file; chunks in use are in memory anyway.

After `kill -9` the file is whole, and after a power loss too, less the last transaction at most: a commit syncs pages
before it writes the root that points to them, and the next commit syncs that root (`metasync` off). Without any sync
the root could come first. LMDB's map is not written to (`writemap` off): a full disk is an error then, not a signal,
and no stray pointer reaches the file.

LMDB trusts its own pages: a damaged one can end the process. So after a server that was killed, all of them are checked
before the file is opened, 0.6 s a GB, and no damage ends one server after the other. Entries have checksums.
"""

import fcntl
import logging
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import lmdb
from lmdb.verify import VerifyError, verify

from chunkserver.errors import StoreError, StoreFull
from chunkserver.mesh import Content
from chunkserver.pipeline import Chunk

FORMAT: Final = 2
"""Raised when an older file would be read wrongly: it is emptied then."""
FILE_NAME: Final = f"chunks-{FORMAT}.mdb"
FILES: Final = "chunks-*.mdb*"
LOCK_NAME: Final = "chunks.lock"
RUNNING: Final = b"running\n"

LIVE_EIGHTHS: Final = 7
"""Of the file, for what is kept. The rest is for pages that were freed: they can be used two transactions later."""
WRITE_PART: Final = 32
"""A transaction writes at most this part of the file: a quarter of what is not for keeping."""

assert WRITE_PART * (8 - LIVE_EIGHTHS) >= 8 * 4, "room for what four transactions free"

_CONTENTS: Final[tuple[Content, ...]] = ("air", "rock", "surface")
"""By their number in the file."""
_CHECKSUM: Final = struct.Struct("<I")
"""Begins an entry: CRC-32 of its key and of what follows."""
_HEAD: Final = struct.Struct("<BQ")
"""Follows: content and revision. Then comes the body."""
_SEQUENCE: Final = struct.Struct(">Q")
"""A key of `order`: its bytes sort as the numbers do."""
_RUIN: Final = (lmdb.CorruptedError, lmdb.PageNotFoundError, lmdb.PanicError, lmdb.InvalidError)

Writes: TypeAlias = Sequence[tuple[bytes, Chunk | None]]
"""Keys, and what to keep under each: None to delete what is there."""

_log: Final = logging.getLogger(__name__)


class TornEntry(Exception):
    """An entry is not what was written."""


class ChunkFile:
    """The open file. One thread may call `read` while another calls `write`.

    ruined: whether LMDB found its own pages damaged. Then all calls fail, and the file is gone at the next start.
    entries: chunks in it. bytes: of the pages that they take. evicted: those that made room since it was opened.
    """

    def __init__(self, path: Path, bytes_max: int) -> None:
        """Raises `lmdb.Error` if the file is none of LMDB's, or not whole."""
        self.ruined = False
        self.entries = self.bytes = self.evicted = 0
        self._path = path
        self._live_bytes_max = bytes_max * LIVE_EIGHTHS // 8
        self._env = lmdb.open(str(path), bytes_max, subdir=False, metasync=False, max_dbs=2)
        self._chunks, self._order = self._env.open_db(b"chunks"), self._env.open_db(b"order")
        self._commit((), self._live_bytes_max)

    def read(self, key: bytes) -> Chunk | None:
        """Return the chunk under `key`, or None. Raises `TornEntry` and `StoreError`."""
        with self._told(), self._env.begin(self._chunks, buffers=True) as txn:
            entry = txn.get(key)
            return None if entry is None else _unpacked(key, entry)

    def write(self, writes: Writes) -> None:
        """Write all or nothing, and delete the oldest until the rest fits. At most 1 / WRITE_PART of the file.

        Raises `StoreFull` if there was no room for it, in the file or on the disk; `StoreError` if it failed otherwise.
        """
        with self._told():
            try:
                self._commit(writes, self._live_bytes_max)
            except lmdb.MapFullError:  # free pages are there, but not enough of them side by side
                for _ in range(2):  # what the first frees, the one after the second can use
                    self._commit((), self.bytes * 7 // 8)
                self._commit(writes, self._live_bytes_max)

    def close(self) -> None:
        """Close the file. No call may be under way."""
        self._env.close()

    def _commit(self, writes: Writes, live_bytes_max: int) -> None:
        with self._env.begin(write=True) as txn:
            for number, (key, chunk) in enumerate(writes, self._next_number(txn)):
                if chunk is None:
                    txn.delete(key, db=self._chunks)
                else:
                    txn.put(key, _packed(key, chunk), db=self._chunks)
                    txn.put(_SEQUENCE.pack(number), key, db=self._order, append=True)
            evicted = self._evict(txn, live_bytes_max)
            entries, live_bytes = txn.stat(self._chunks)["entries"], self._live_bytes(txn)
        self.evicted += evicted
        self.entries, self.bytes = entries, live_bytes

    def _next_number(self, txn: "lmdb.Transaction[bytes]") -> int:
        with txn.cursor(self._order) as newest:
            return int(_SEQUENCE.unpack(newest.key())[0]) + 1 if newest.last() else 0

    def _evict(self, txn: "lmdb.Transaction[bytes]", live_bytes_max: int) -> int:
        """Delete the oldest until the rest fits; return how many. A key that was written twice goes with its first."""
        evicted = 0
        with txn.cursor(self._order) as oldest:
            while self._live_bytes(txn) > live_bytes_max and oldest.first():
                evicted += txn.delete(oldest.value(), db=self._chunks)
                oldest.delete()
        return evicted

    def _live_bytes(self, txn: "lmdb.Transaction[bytes]") -> int:
        """Return the size of the pages in use, as LMDB itself counts them."""
        tables = (txn.stat(self._chunks), txn.stat(self._order))
        return sum(t["psize"] * (t["branch_pages"] + t["leaf_pages"] + t["overflow_pages"]) for t in tables)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn what LMDB says into `StoreError`. A ruined file loses its name: the next start makes a new one."""
        try:
            yield
        except (lmdb.MapFullError, lmdb.DiskError) as error:
            raise StoreFull(f"{self._path}: {error}") from error
        except lmdb.Error as error:
            if isinstance(error, _RUIN):
                self.ruined = True
                self._path.unlink(missing_ok=True)
            raise StoreError(f"{self._path}: {error}") from error


def claim(folder: Path) -> BinaryIO:
    """Return the lock of `folder`, held, which is made if need be. Closing it gives the folder back.

    Raises `StoreError` that names the folder if it cannot be used or another server has it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK_NAME).open("a+b")
    except OSError as error:
        raise StoreError(f"{folder} cannot be used: {error}", folder=str(folder)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise StoreError(f"{folder} is in use: another server caches in it", folder=str(folder)) from error
    return lock


def open_claimed(folder: Path, bytes_max: int, lock: BinaryIO) -> ChunkFile:
    """Return the file in `folder`, whose `lock` is held: as it was left, or empty if that cannot be trusted.

    Raises `StoreError` if there cannot be one, whatever was there before.
    """
    path = folder / FILE_NAME
    try:
        lock.seek(0)
        fault = _fault(path, bytes_max, was_killed=bool(lock.read()))
        lock.truncate(0)
        lock.write(RUNNING)
        lock.flush()
        os.fsync(lock.fileno())
        if not fault:
            try:
                return ChunkFile(path, bytes_max)
            except lmdb.Error as error:
                fault = str(error)
        _log.warning("%s: %s: the disk cache starts empty", folder, fault)
        for old in folder.glob(FILES):
            old.unlink()
        return ChunkFile(path, bytes_max)
    except (OSError, lmdb.Error) as error:
        raise StoreError(f"{folder} cannot be used: {error}", folder=str(folder)) from error


def give_back(lock: BinaryIO, *, whole: bool) -> None:
    """Give the folder of `lock` to the next server. whole: the file was closed, and need not be checked."""
    if whole:
        lock.truncate(0)
    lock.close()


def _fault(path: Path, bytes_max: int, *, was_killed: bool) -> str | None:
    """Return what speaks against opening the file, or None. All of its pages are read if a server was killed on it."""
    others = sorted(file.name for file in path.parent.glob(FILES) if not file.name.startswith(FILE_NAME))
    if others:
        return f"{others[0]} is of another version"
    if not path.exists():
        return None
    if path.stat().st_size > bytes_max:
        return f"{FILE_NAME} is larger than {bytes_max} bytes"
    if not was_killed:
        return None
    try:
        faults = verify(str(path))  # type: ignore[no-untyped-call]
    except VerifyError as error:
        return f"{FILE_NAME} is damaged: {error}"
    return f"{FILE_NAME} is damaged: {faults[0]}" if faults else None


def _packed(key: bytes, chunk: Chunk) -> bytes:
    head = _HEAD.pack(_CONTENTS.index(chunk.content), chunk.revision)
    return b"".join((_CHECKSUM.pack(zlib.crc32(chunk.body, zlib.crc32(key + head))), head, chunk.body))


def _unpacked(key: bytes, entry: memoryview) -> Chunk:
    """Raises `TornEntry` unless this is what `_packed` made of a chunk under the same key."""
    said, rest = entry[: _CHECKSUM.size], entry[_CHECKSUM.size :]
    if len(rest) < _HEAD.size or said != _CHECKSUM.pack(zlib.crc32(rest, zlib.crc32(key))):
        raise TornEntry
    content, revision = _HEAD.unpack_from(rest)
    return Chunk(_CONTENTS[content], bytes(rest[_HEAD.size :]), revision)
