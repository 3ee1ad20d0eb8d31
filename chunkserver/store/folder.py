"""Everything that a server keeps in its folder, opened and closed together."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from chunkserver.errors import StoreError
from chunkserver.store import copying
from chunkserver.store.catalogue import Catalogue
from chunkserver.store.foundation import Part
from chunkserver.store.log import EditLog
from chunkserver.store.snapshots import Snapshots
from chunkserver.store.sqlite import FILE_NAME, Database
from chunkserver.store.writer import Writer
from chunkserver.world import World


class Kept(NamedTuple):
    """What the edits of a world up to `revision` have made, in parts. what: where it is kept, for people."""

    what: str
    revision: int
    parts: Iterable[Part]


class Store:
    """What is kept in `folder`, which is made if need be; in memory only, without a folder.

    folder: None if nothing is kept.
    catalogue: its worlds.
    log: their edits.
    writer: how an edit comes into the log.
    snapshots: what was made of the edits.

    Raises what `Database` does.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self._database = Database(folder)
        try:
            self.catalogue = Catalogue(self._database)
        except BaseException:
            self._database.close()
            raise
        self.log = EditLog(self._database)
        self.writer = Writer(self.log.append)
        self.snapshots = Snapshots(folder)

    @classmethod
    def existing(cls, folder: Path) -> "Store":
        """Return what is kept in `folder`. Raises `StoreError` too if it holds no worlds; then nothing is made."""
        if not (folder / FILE_NAME).exists():
            raise StoreError(f"{folder} holds no worlds: there is no {FILE_NAME} in it", folder=str(folder))
        return cls(folder)

    @staticmethod
    def back_up(folder: Path, copy: Path) -> None:
        """Write a copy of what must last of a folder into one new file, as of one moment. A server may run on it.

        Raises `StoreError` if it holds no worlds, if there is a file of that name, or if it cannot be written.
        """
        copying.back_up(folder, copy)

    @staticmethod
    def restore(copy: Path, folder: Path) -> list[World]:
        """Put such a copy into a folder that holds no worlds. Return its worlds, which have new epochs.

        Raises `StoreError` if it holds worlds, or if the copy cannot be read. Then it still holds none.
        """
        return copying.restore(copy, folder)

    def kept(self, epoch: str, generator: str) -> list[Kept]:
        """Return what a world can begin with: its snapshot, if there is one that fits the log, then the foundation.

        That is always there: of revision 0, without parts, before there is any. Raises `WorldGone` or `StoreError`.
        """
        foundation, snapshot = self.log.foundation(epoch), self.snapshots.load(epoch, generator)
        states = [Kept("foundation", *foundation)]
        if snapshot is not None and foundation.revision <= snapshot.revision <= self.log.revision(epoch):
            states.insert(0, Kept("snapshot", snapshot.revision, snapshot.parts.items()))
        return states

    def close(self) -> None:
        """Write the edits that wait, and give the folder back."""
        self.writer.close()
        self.snapshots.close()
        self._database.close()
