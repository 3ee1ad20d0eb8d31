"""The catalogue on the event loop: reads at once, writes in a thread of their own, and waits for a revision."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

from chunkserver.edits import Arena
from chunkserver.errors import DeadlinePassed
from chunkserver.pipeline import generator
from chunkserver.server.editing import Editing
from chunkserver.server.problems import OtherGenerator, UnknownWorld
from chunkserver.store import Store
from chunkserver.world import World

_Written = TypeVar("_Written")


class WorldStore:
    """The worlds of one server. Belongs to the event loop; closes the store that it is given.

    edits: theirs.
    durable: whether they outlive the server.
    answer_seconds: how long `at_revision` waits at most.
    """

    def __init__(self, store: Store, answer_seconds: float, arena: Arena, log_edits: int) -> None:
        """arena: where the bricks of edits lie. log_edits: of each world, that are kept one by one at least."""
        self.edits = Editing(store, arena, answer_seconds, log_edits)
        self.edits.moved = self._move
        self.durable = store.folder is not None
        self.answer_seconds = answer_seconds
        self._store = store
        self._catalogue = store.catalogue
        store.snapshots.keep(world.epoch for world in self._catalogue.page("", len(self._catalogue)))
        self._writer = ThreadPoolExecutor(1, "catalogue")
        self._moved = asyncio.Event()

    def __len__(self) -> int:
        return len(self._catalogue)

    def find(self, name: str) -> World:
        """Return the world whose id is `name`.

        Raises `UnknownWorld`, or `OtherGenerator` if this server would make other terrain of it.
        """
        world = self._kept(name)
        check_generator_of(world)
        return self._as_of_now(world)

    def page(self, after: str, limit: int) -> list[World]:
        """Return the first `limit` worlds whose id sorts behind `after`, by id, whatever generator made them."""
        return [self._as_of_now(world) for world in self._catalogue.page(after, limit)]

    def holds(self, name: str, epoch: str) -> bool:
        """Return whether the world whose id is `name` still is the one of `epoch`."""
        world = self._catalogue.find(name)
        return world is not None and world.epoch == epoch

    def revision(self, name: str) -> int:
        """Return how many edits the world whose id is `name` has taken. Raises `UnknownWorld`."""
        return self.edits.revision(self._kept(name))

    async def at_revision(self, name: str, revision: int) -> World:
        """Return the world whose id is `name` when it has `revision`. Raises what `find` does, and `DeadlinePassed`."""
        try:
            async with asyncio.timeout(self.answer_seconds):
                while self.find(name).revision < revision:
                    await self._moved.wait()
        except TimeoutError:
            message = f"world {name!r} did not get to revision {revision} within {self.answer_seconds:g} s"
            raise DeadlinePassed(message, min_revision=str(revision), answer_seconds=self.answer_seconds) from None
        return self.find(name)

    async def start(self) -> None:
        """Begin to tidy up; returns at once."""
        self.edits.sweep()

    async def create(self, world: World) -> World:
        """Return the world that has this id: `world`, or one that had it before. Raises `StoreError`."""
        return await self._write(lambda: self._catalogue.create(world))

    async def delete(self, name: str) -> None:
        """Delete the world whose id is `name`. Raises `UnknownWorld` or `StoreError`."""
        gone = await self._write(lambda: self._catalogue.delete(name))
        if gone is None:
            raise UnknownWorld(f"there is no world {name!r}", world=name)
        self.edits.forget(gone.epoch)

    async def close(self) -> None:
        """Finish what is being written, and give the folder back."""
        await asyncio.to_thread(self._writer.shutdown)
        await asyncio.to_thread(self._store.writer.close)
        await self.edits.close()
        self._store.close()

    def _kept(self, name: str) -> World:
        world = self._catalogue.find(name)
        if world is None:
            raise UnknownWorld(f"there is no world {name!r}", world=name)
        return world

    async def _write(self, change: Callable[[], _Written]) -> _Written:
        written = await asyncio.get_running_loop().run_in_executor(self._writer, change)
        self._move()
        return written

    def _as_of_now(self, world: World) -> World:
        revision = self.edits.revision(world)
        return world if revision == world.revision else replace(world, revision=revision)

    def _move(self) -> None:
        """Wake all who wait for a revision."""
        self._moved.set()
        self._moved = asyncio.Event()


def check_generator_of(world: World) -> None:
    """Raise `OtherGenerator` if this server would make other terrain of `world` than the one that created it."""
    current = generator(world.recipe)
    if world.generator != current:
        message = (
            f"world {world.id!r} was created by generator {world.generator}, and this server has {current}, which "
            "would make other terrain; `chunkserver migrate` moves the world to it"
        )
        raise OtherGenerator(message, world=world.id, created_by=world.generator, generator=current)
