"""Which worlds there are: a folder that one server owns, and in it an SQLite file with a row for each world.

    Catalogue(folder)        lock           held with flock while the catalogue is open, given back by the kernel
                             worlds.sqlite  write-ahead log, a sync for each commit

All rows are also in memory, loaded at the start: `find` and `page` never wait for the disk, and are safe in any thread.
`create` and `delete` return when the disk has it; they take turns. Knows no HTTP and no asyncio.
"""

import fcntl
import logging
import os
import re
import secrets
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import apsw

from chunkserver.errors import BadParameter, BadRecipe, BadRequest, StoreError, StoreFull
from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, LOD_MAX
from chunkserver.recipe import WorldRecipe

WORLDS_MAX: Final = 10_000
SOURCES_BYTES_MAX: Final = 64 << 20
"""Of the recipes of all worlds, which are kept in memory. One that two worlds have counts twice."""

ID_PATTERN: Final = "^[a-z0-9_-]{1,64}$"
LODS_DEFAULT: Final = 12
VOXEL_SIZE_DEFAULT: Final = 1.0
EPOCH_BYTES: Final = 16

APPLICATION_ID: Final = 0x43484E4B
"""In the header of the file: no other program's file is taken for ours."""
FORMAT: Final = 1
"""Of the file. Raised when an older server could not read it any more; a newer file is refused."""
FILE_NAME: Final = "worlds.sqlite"
LOCK_NAME: Final = "lock"
BUSY_MS_MAX: Final = 5000
"""How long a write waits for somebody who looks into the file with another program."""

_ID: Final = re.compile(ID_PATTERN.strip("^$"))
_IN_MEMORY: Final = ":memory:"
_SYNCHRONOUS_FULL: Final = 2
_COLUMNS: Final = "id, epoch, seed, source, recipe_name, voxel_size, lods, chunk_cells, generator, created"
_SCHEMA: Final = f"""
CREATE TABLE worlds (
    id TEXT PRIMARY KEY, epoch TEXT NOT NULL, seed INTEGER NOT NULL, source TEXT NOT NULL, recipe_name TEXT NOT NULL,
    voxel_size REAL NOT NULL, lods INTEGER NOT NULL, chunk_cells INTEGER NOT NULL, generator TEXT NOT NULL,
    created TEXT NOT NULL
) STRICT, WITHOUT ROWID;
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FORMAT};
"""

_Row = tuple[str, str, int, str, str, float, int, int, str, str]

_log: Final = logging.getLogger(__name__)


def _new_epoch() -> str:
    return secrets.token_hex(EPOCH_BYTES)


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """One world. A new one gets a new epoch.

    id: what URLs call it.
    recipe: its seed, and the expression tree as canonical JSON.
    recipe_name: what its creator called the recipe: the name of a built-in, or the digest.
    generator: the token of the generator that it was created with; another one makes other terrain.
    voxel_size: metres. Its limits are those of the wire formats, and not checked here.
    lods: levels of detail, 0 to lods - 1.
    chunk_cells: cells a side of a chunk.
    epoch: random hex. Another epoch is another world, under the same id too.
    created: UTC, ISO 8601, to the second.
    revision: how many edits it has taken.

    Raises `BadParameter` for a malformed id, and for lods or chunk_cells that are not built.
    """

    id: str
    recipe: WorldRecipe
    recipe_name: str
    generator: str
    voxel_size: float = VOXEL_SIZE_DEFAULT
    lods: int = LODS_DEFAULT
    chunk_cells: int = CELLS_DEFAULT
    epoch: str = field(default_factory=_new_epoch)
    created: str = field(default_factory=_now)
    revision: int = 0

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id):
            raise BadParameter(f"id is {self.id[:100]!r}; it must match {ID_PATTERN}", id=self.id)
        if not 1 <= self.lods <= LOD_MAX + 1:
            raise BadParameter(f"lods is {self.lods}; it lies in [1, {LOD_MAX + 1}]", lods=self.lods)
        if self.chunk_cells not in CELLS_BUILT:
            message = f"chunk_cells is {self.chunk_cells}; built are {CELLS_BUILT}"
            raise BadParameter(message, chunk_cells=self.chunk_cells)


class Catalogue:
    """The worlds in `folder`, which is made if need be; in memory only, without a folder.

    folder: None if nothing is kept.

    Raises `StoreError` that names the folder if another server has it, or if it cannot be read or written; that names
    the file if it is damaged, of another program, or of a newer version.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self._writing = threading.Lock()
        self._path = str(folder.absolute() / FILE_NAME) if folder else _IN_MEMORY
        with ExitStack() as held, _told(self._path):
            if folder:
                held.callback(os.close, _locked(folder))
            self._connection = apsw.Connection(self._path)
            held.callback(self._connection.close)
            self._worlds = _opened(self._connection, self._path)
            self._held = held.pop_all()

    def __len__(self) -> int:
        return len(self._worlds)

    def find(self, name: str) -> World | None:
        """Return the world whose id is `name`, or None."""
        return self._worlds.get(name)

    def page(self, after: str, limit: int) -> list[World]:
        """Return the first `limit` worlds whose id sorts behind `after`, by id."""
        worlds = self._worlds
        return [worlds[name] for name in sorted(name for name in worlds if name > after)[:limit]]

    def create(self, world: World) -> World:
        """Return the world that now has this id: `world`, durably; or one that had it before, which is left alone.

        Raises `StoreFull` if there are WORLDS_MAX, their recipes are too long together, or the disk is full;
        `StoreError` if it cannot be written.
        """
        with self._writing:
            found = self._worlds.get(world.id)
            if found is not None:
                return found
            self._check_room(world)
            with _told(self._path):
                marks = ", ".join("?" * len(_row(world)))
                self._connection.execute(f"INSERT INTO worlds ({_COLUMNS}) VALUES ({marks})", _row(world))
            self._worlds = {**self._worlds, world.id: world}  # a new one: whoever reads the old one is not disturbed
            return world

    def delete(self, name: str) -> World | None:
        """Return the world whose id was `name`, now durably deleted; None if there is none. Raises `StoreError`."""
        with self._writing:
            found = self._worlds.get(name)
            if found is not None:
                with _told(self._path):
                    self._connection.execute("DELETE FROM worlds WHERE id = ?", (name,))
                self._worlds = {other: world for other, world in self._worlds.items() if other != name}
            return found

    def repin(self, generators: Mapping[str, str]) -> None:
        """Give worlds other generators, by id: durably, and all or none of them. All else about them stays.

        Raises `StoreError`.
        """
        with self._writing:
            worlds = {name: replace(self._worlds[name], generator=token) for name, token in generators.items()}
            with _told(self._path), self._connection:
                change = "UPDATE worlds SET generator = ? WHERE id = ?"
                self._connection.executemany(change, [(token, name) for name, token in generators.items()])
            self._worlds = {**self._worlds, **worlds}

    def close(self) -> None:
        """Give the folder back. What was written is on the disk already."""
        with self._writing:
            self._held.close()

    def _check_room(self, world: World) -> None:
        if len(self) >= WORLDS_MAX:
            raise StoreFull(f"there are {len(self)} worlds, which is the limit", worlds_max=WORLDS_MAX)
        length = sum(len(kept.recipe.source) for kept in (*self._worlds.values(), world))
        if length > SOURCES_BYTES_MAX:
            message = f"the recipes of all worlds would have {length} bytes; the limit is {SOURCES_BYTES_MAX}"
            raise StoreFull(message, bytes_max=SOURCES_BYTES_MAX)


def migrate(folder: Path, names: Collection[str], generator: Callable[[WorldRecipe], str]) -> list[tuple[World, str]]:
    """Move worlds in a folder to another generator: their terrain is what that makes of the recipe from now on.

    names: their ids; all worlds, if there are none.
    generator: returns the token that a world of this recipe has to have.

    Returns the worlds that had another one, as they are now, each with the token that it had. Epoch and revision stay.
    Raises `StoreError` if a server runs on the folder, if it holds no worlds or not this one, or if a recipe cannot be
    read any more. Then none has been moved.
    """
    if not (folder / FILE_NAME).exists():
        raise StoreError(f"{folder} holds no worlds: there is no {FILE_NAME} in it", folder=str(folder))
    catalogue = Catalogue(folder)
    try:
        worlds = [_existing(catalogue, name) for name in names] if names else catalogue.page("", WORLDS_MAX)
        old = {world.id: world.generator for world in worlds if world.generator != generator(world.recipe)}
        catalogue.repin({world.id: _token(world, generator) for world in worlds if world.id in old})
        return [(_existing(catalogue, name), before) for name, before in old.items()]
    finally:
        catalogue.close()


def _existing(catalogue: Catalogue, name: str) -> World:
    world = catalogue.find(name)
    if world is None:
        raise StoreError(f"there is no world {name!r} in {catalogue.folder}", world=name)
    return world


def _token(world: World, generator: Callable[[WorldRecipe], str]) -> str:
    try:
        _ = world.recipe.expression
    except BadRecipe as error:
        raise StoreError(f"world {world.id!r} has a recipe of which nothing can be made: {error.message}") from error
    return generator(world.recipe)


def _locked(folder: Path) -> int:
    """Return the descriptor that holds the folder. It is closed on exec: no child keeps the folder from the next."""
    try:
        _make_durable(folder)
        lock = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(f"{folder} cannot be used: {error}", folder=str(folder)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise StoreError(f"{folder} is in use: another server runs on it", folder=str(folder)) from error
    return lock


def _make_durable(folder: Path) -> None:
    """Make the folder and those above it. A new one is lost with the power until the one above it is synced."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for path in missing:
        above = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(above)
        finally:
            os.close(above)


def _opened(connection: apsw.Connection, path: str) -> dict[str, World]:
    """Return the worlds in a file, after it has been found to be ours and whole. Only then is anything written."""
    connection.set_busy_timeout(BUSY_MS_MAX)
    new = _is_new(connection, path)
    _make_safe(connection, path)
    if new:
        with connection:
            connection.execute(_SCHEMA)
    rows: Iterator[_Row] = connection.execute(f"SELECT {_COLUMNS} FROM worlds ORDER BY id")
    return {row[0]: _world(row, path) for row in rows}


def _is_new(connection: apsw.Connection, path: str) -> bool:
    """Whether the file is empty. Raises `StoreError` if it is damaged, not ours, or of a newer version."""
    application, version = connection.pragma("application_id"), connection.pragma("user_version")
    tables = connection.execute("SELECT count(*) FROM sqlite_schema").get
    if (application, version, tables) == (0, 0, 0):
        return True
    if application != APPLICATION_ID:
        raise StoreError(f"{path} is no file of worlds: another program has made it", path=path)
    if version > FORMAT:
        message = f"{path} has format {version}; this version of chunkserver reads {FORMAT}: use a newer one"
        raise StoreError(message, path=path, format=version)
    verdict = connection.pragma("integrity_check", 1)
    if verdict != "ok":
        raise StoreError(f"{path} is damaged: {verdict}", path=path)
    return False


def _make_safe(connection: apsw.Connection, path: str) -> None:
    """Have every commit synced before it is answered. Raises `StoreError` if it cannot be had."""
    journal = connection.pragma("journal_mode", "wal")
    connection.pragma("synchronous", "full")
    if path != _IN_MEMORY and (journal, connection.pragma("synchronous")) != ("wal", _SYNCHRONOUS_FULL):
        raise StoreError(f"{path}: journal_mode is {journal!r}; it must be 'wal', with synchronous = FULL", path=path)


def _row(world: World) -> _Row:
    return (
        *(world.id, world.epoch, world.recipe.seed, world.recipe.source, world.recipe_name),
        *(world.voxel_size, world.lods, world.chunk_cells, world.generator, world.created),
    )


def _world(row: _Row, path: str) -> World:
    name, epoch, seed, source, recipe_name, voxel_size, lods, chunk_cells, generator, created = row
    try:
        return World(
            id=name,
            epoch=epoch,
            recipe=WorldRecipe(seed, source),
            recipe_name=recipe_name,
            voxel_size=voxel_size,
            lods=lods,
            chunk_cells=chunk_cells,
            generator=generator,
            created=created,
        )
    except BadRequest as error:
        raise StoreError(f"{path} is damaged: {error.message}", path=path) from error


@contextmanager
def _told(path: str) -> Iterator[None]:
    """Turn what SQLite says into `StoreError`. Clients are told of a full disk, but not of our paths."""
    try:
        yield
    except apsw.FullError as error:
        _log.error("%s: %s", path, error)
        raise StoreFull("the disk is full") from error
    except apsw.Error as error:
        raise StoreError(f"{path}: {error}", path=path) from error
