"""What must last: the one package that knows SQLite. `Store` opens a folder; all else hangs on it."""

from chunkserver.store.catalogue import Catalogue
from chunkserver.store.draft import Draft, Outcome
from chunkserver.store.folder import Store
from chunkserver.store.log import EditLog
from chunkserver.store.migration import migrate

__all__ = ["Catalogue", "Draft", "EditLog", "Outcome", "Store", "migrate"]
