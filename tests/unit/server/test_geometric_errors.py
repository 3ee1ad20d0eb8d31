"""Errors of levels: read out of the headers of chunks, once for each recipe."""

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest

from chunkserver.errors import Overloaded
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import LOD_MAX, ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import geometric_errors
from chunkserver.server.geometric_errors import GeometricErrors

HILLS = WorldRecipe(3, builtin("hills"))


class Builder:
    """Builds in this process; raises `error` instead if there is one."""

    def __init__(self) -> None:
        self.asked: list[ChunkRequest] = []
        self.waiting = self.waiting_max = 0
        self.error: Exception | None = None
        self.answer: Chunk | None = None
        self.ready = True
        self.held = asyncio.Event()
        self.held.set()

    async def build(self, request: ChunkRequest, begun: Callable[[], None], *, urgency: int) -> Chunk:
        begun()
        assert urgency == 0
        self.asked.append(request)
        self.waiting += 1
        self.waiting_max = max(self.waiting, self.waiting_max)
        await asyncio.sleep(0)
        await self.held.wait()
        self.waiting -= 1
        if self.error is not None:
            raise self.error
        return self.answer or build_chunk(request)


def test_they_are_those_of_the_chunks_and_asked_for_once():
    build_chunk(ChunkRequest(HILLS, ChunkKey(0, 0, 0, 0)))  # what compiles now does not take of the time below

    async def ask() -> None:
        builder = Builder()
        errors = GeometricErrors(builder)
        found = await asyncio.gather(*(errors.find(replace(HILLS, seed=seed)) for seed in range(5)))
        assert set(found) == {tuple(geometric_error(HILLS, lod) for lod in range(LOD_MAX + 1))}
        assert [request.key.lod for request in builder.asked] == list(range(LOD_MAX + 1))
        assert builder.waiting_max == 1, "one place in the queue"

    asyncio.run(ask())


def test_a_failure_is_not_kept():
    async def ask() -> None:
        builder = Builder()
        builder.error = Overloaded("full")
        errors = GeometricErrors(builder)
        assert set(await asyncio.gather(errors.find(HILLS), errors.find(HILLS))) == {None}
        builder.error = None
        assert len(await errors.find(HILLS) or ()) == LOD_MAX + 1

    asyncio.run(ask())


def test_a_descriptor_does_not_wait_for_workers_that_are_not_there(monkeypatch):
    async def ask() -> None:
        builder = Builder()
        builder.ready = False
        builder.held.clear()
        errors = GeometricErrors(builder)
        assert await errors.find(HILLS) is None
        builder.ready = True
        monkeypatch.setattr(geometric_errors, "WAIT_SECONDS", 0.01)
        assert await errors.find(HILLS) is None, "they take too long"
        builder.held.set()
        monkeypatch.setattr(geometric_errors, "WAIT_SECONDS", 60)
        assert len(await errors.find(HILLS) or ()) == LOD_MAX + 1
        assert len(builder.asked) == LOD_MAX + 1, "what was begun went on"

    asyncio.run(ask())


def test_a_chunk_that_does_not_say_it_is_a_failure():
    async def ask() -> None:
        builder = Builder()
        builder.answer = Chunk("surface", b"a mesh")
        assert await GeometricErrors(builder).find(HILLS) is None

    asyncio.run(ask())


def test_a_client_that_leaves_takes_nothing_from_the_others():
    async def ask() -> None:
        errors = GeometricErrors(Builder())
        first, second = (asyncio.ensure_future(errors.find(HILLS)) for _ in range(2))
        await asyncio.sleep(0)
        first.cancel()
        assert len(await second or ()) == LOD_MAX + 1
        with pytest.raises(asyncio.CancelledError):
            await first

    asyncio.run(ask())


def test_the_least_recently_used_are_forgotten(monkeypatch):
    monkeypatch.setattr(geometric_errors, "KEPT_MAX", 2)

    async def ask() -> None:
        builder = Builder()
        errors = GeometricErrors(builder)
        hills, plane, sphere = (WorldRecipe(0, builtin(name)) for name in ("hills", "plane", "sphere"))
        for recipe in (hills, plane, hills, sphere, hills):
            await errors.find(recipe)
        assert len(builder.asked) == 3 * (LOD_MAX + 1)
        await errors.find(plane)
        assert len(builder.asked) == 4 * (LOD_MAX + 1)

    asyncio.run(ask())
