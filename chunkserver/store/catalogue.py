"""Which worlds there are: a row for each in the file, and all of them in memory.

`find` and `page` never wait for the disk. `create` and `delete` return when the disk has it; they take turns. Safe in
any thread. Knows no HTTP and no asyncio.
"""

import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Final

from chunkserver.errors import BadRequest, StoreError, StoreFull
from chunkserver.recipe import WorldRecipe
from chunkserver.store.sqlite import Database
from chunkserver.world import WORLDS_MAX, World, new_epoch

SOURCES_BYTES_MAX: Final = 64 << 20
"""Of the recipes of all worlds, which are kept in memory. One that two worlds have counts twice."""

_MIGRATED: Final = (
    "UPDATE logs SET migrated = (SELECT revision FROM tails WHERE tails.epoch = logs.epoch) WHERE epoch = ?"
)
_COLUMNS: Final = "id, epoch, seed, source, recipe_name, voxel_size, lods, chunk_cells, generator, created"

_WORLDLESS: Final = "epoch NOT IN (SELECT epoch FROM worlds)"

_Row = tuple[str, str, int, str, str, float, int, int, str, str]


class Catalogue:
    """The worlds of a database, with the revisions that they have at the start.

    Raises `StoreError` if one of its rows makes no world.
    """

    def __init__(self, database: Database) -> None:
        self.folder = database.folder
        self._writing = threading.Lock()
        self._database = database
        with database.read() as connection:
            rows: Iterator[tuple[*_Row, int]] = connection.execute(
                f"SELECT {_COLUMNS}, revision FROM worlds JOIN tails USING (epoch) ORDER BY id"
            )
            self._worlds = {row[0]: _world(row, database.path) for row in rows}
            left = connection.execute(f"SELECT count(*) FROM logs WHERE {_WORLDLESS}").get
        if left:
            with database.write() as connection:
                connection.execute(f"DELETE FROM logs WHERE {_WORLDLESS}")

    def __len__(self) -> int:
        return len(self._worlds)

    def find(self, name: str) -> World | None:
        """Return the world whose id is `name`, or None."""
        return self._worlds.get(name)

    def page(self, after: str, limit: int) -> list[World]:
        """Return the first `limit` worlds whose id sorts behind `after`, by id."""
        worlds = self._worlds
        return [worlds[name] for name in sorted(name for name in worlds if name > after)[:limit]]

    def prepare(self, epoch: str, migrated: int = 0) -> None:
        """Begin the log of a world that is yet to be created with this epoch: nobody finds it before.

        migrated: up to which revision its edits were made in another generator's terrain, `EditLog.migrated`.

        If the world is not created, its log is gone when the catalogue is opened again. Raises `StoreError`.
        """
        with self._database.write() as connection:
            connection.execute("INSERT INTO logs (epoch, migrated) VALUES (?, ?)", (epoch, migrated))

    def create(self, world: World) -> World:
        """Return the world that now has this id: `world`, durably; or one that had it before, which is left alone.

        Its log is empty, if it was not prepared.

        Raises `StoreFull` if there are WORLDS_MAX, their recipes are too long together, or the disk is full;
        `StoreError` if it cannot be written.
        """
        with self._writing:
            found = self._worlds.get(world.id)
            if found is not None:
                return found
            self._check_room(world)
            marks = ", ".join("?" * len(_row(world)))
            with self._database.write() as connection:
                connection.execute(f"INSERT INTO worlds ({_COLUMNS}) VALUES ({marks})", _row(world))
            self._worlds = {**self._worlds, world.id: world}  # a new one: whoever reads the old one is not disturbed
            return world

    def delete(self, name: str) -> World | None:
        """Return the world whose id was `name`, now durably deleted; None if there is none. Raises `StoreError`."""
        with self._writing:
            found = self._worlds.get(name)
            if found is not None:
                with self._database.write() as connection:
                    connection.execute("DELETE FROM worlds WHERE id = ?", (name,))
                self._worlds = {other: world for other, world in self._worlds.items() if other != name}
            return found

    def repin(self, generators: Mapping[str, str]) -> None:
        """Give worlds other generators, by id: durably, and all or none of them. All else about them stays.

        Raises `StoreError`.
        """
        with self._writing:
            worlds = {name: replace(self._worlds[name], generator=token) for name, token in generators.items()}
            change = "UPDATE worlds SET generator = ? WHERE id = ?"
            with self._database.write() as connection:
                connection.executemany(change, [(token, name) for name, token in generators.items()])
                connection.executemany(_MIGRATED, [(world.epoch,) for world in worlds.values()])
            self._worlds = {**self._worlds, **worlds}

    def renew(self) -> list[World]:
        """Give every world a new epoch, durably, and return them: their logs are not those that clients have seen.

        Raises `StoreError`.
        """
        with self._writing:
            worlds = {name: replace(world, epoch=new_epoch()) for name, world in self._worlds.items()}
            epochs = [(worlds[name].epoch, world.epoch) for name, world in self._worlds.items()]
            with self._database.write() as connection:
                for table in ("logs", "worlds"):
                    connection.executemany(f"UPDATE {table} SET epoch = ? WHERE epoch = ?", epochs)
            self._worlds = worlds
            return list(worlds.values())

    def _check_room(self, world: World) -> None:
        if len(self) >= WORLDS_MAX:
            raise StoreFull(f"there are {len(self)} worlds, which is the limit", worlds_max=WORLDS_MAX)
        length = sum(len(kept.recipe.source) for kept in (*self._worlds.values(), world))
        if length > SOURCES_BYTES_MAX:
            message = f"the recipes of all worlds would have {length} bytes; the limit is {SOURCES_BYTES_MAX}"
            raise StoreFull(message, bytes_max=SOURCES_BYTES_MAX)


def _row(world: World) -> _Row:
    return (
        *(world.id, world.epoch, world.recipe.seed, world.recipe.source, world.recipe_name),
        *(world.voxel_size, world.lods, world.chunk_cells, world.generator, world.created),
    )


def _world(row: tuple[*_Row, int], path: str) -> World:
    name, epoch, seed, source, recipe_name, voxel_size, lods, chunk_cells, generator, created, revision = row
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
            revision=revision,
        )
    except BadRequest as error:
        raise StoreError(f"{path} is damaged: {error.message}", path=path) from error
