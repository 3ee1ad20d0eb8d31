"""Everything that a server keeps in its folder, opened and closed together."""

from pathlib import Path

from chunkserver.errors import StoreError
from chunkserver.store.catalogue import Catalogue
from chunkserver.store.sqlite import FILE_NAME, Database


class Store:
    """What is kept in `folder`, which is made if need be; in memory only, without a folder.

    folder: None if nothing is kept.
    catalogue: its worlds.

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

    @classmethod
    def existing(cls, folder: Path) -> "Store":
        """Return what is kept in `folder`. Raises `StoreError` too if it holds no worlds; then nothing is made."""
        if not (folder / FILE_NAME).exists():
            raise StoreError(f"{folder} holds no worlds: there is no {FILE_NAME} in it", folder=str(folder))
        return cls(folder)

    def close(self) -> None:
        """Give the folder back. What was written is on the disk already."""
        self._database.close()
