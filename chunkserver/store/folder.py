"""Everything that a server keeps in its folder, opened and closed together."""

from pathlib import Path

from chunkserver.errors import StoreError
from chunkserver.store.catalogue import Catalogue
from chunkserver.store.log import EditLog
from chunkserver.store.snapshots import Snapshots
from chunkserver.store.sqlite import FILE_NAME, Database
from chunkserver.store.writer import Writer


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

    def close(self) -> None:
        """Write the edits that wait, and give the folder back."""
        self.writer.close()
        self.snapshots.close()
        self._database.close()
