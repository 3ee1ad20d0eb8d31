"""The client for the event loop: `write_async_client.py` makes it of `client.py`."""

import ssl
from collections.abc import AsyncIterator, Iterable, Sequence
from types import TracebackType
from typing import Any, Self, Unpack

import httpx2

from chunkserver_client.calls import Calls
from chunkserver_client.coding import Coding
from chunkserver_client.descriptors import ChunkHead, ListedWorld, Recipe, SeedDescriptor, WorldDescriptor
from chunkserver_client.driving import AsyncCall, Returned
from chunkserver_client.edit_stream import Address, AsyncEditStream
from chunkserver_client.edits import LoggedEdit, Stroke, WrittenEdit
from chunkserver_client.mesh import ChunkMesh
from chunkserver_client.questions import AnyWorld, ChunkOptions, Key, MaskedKey, RecipeTree
from chunkserver_client.retry import Retry
from chunkserver_client.settings import CACHE_BYTES, READY_SECONDS, TIMEOUT, calls_of, headers_of, tls_of
from chunkserver_client.steps import Steps, Value
from chunkserver_client.stream import Region


class AsyncClient:
    """A client of one server. Close it, or use it in an `async with` statement.

    It keeps up to 100 connections, and may be shared: by threads, of an `AsyncClient` by the tasks of one event loop.

    url: of the server: `http://127.0.0.1:8000`. A path, of a proxy, stays in front.
    api_key: sent as `Authorization: Bearer`.
    retry: how patient it is.
    cache_bytes: of answers that are kept in memory; 0 keeps none.
    coding: how chunks travel.
    timeout: seconds for connecting, each read, each write, and for a free connection.
    tls: for https, where the default's authorities are not the right ones.
    transport: of httpx2, for what its own cannot do.

    Every method raises `Problem` for an answer that is an error, `BadAnswer` for one that is not what the documents
    say, and `Unreachable` if none came: `errors.py` draws the tree.
    """

    def __init__(
        self,
        url: str,
        *,
        api_key: str | None = None,
        retry: Retry | None = None,
        cache_bytes: int = CACHE_BYTES,
        coding: Coding = "zstd",
        timeout: httpx2.Timeout = TIMEOUT,
        tls: ssl.SSLContext | None = None,
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        self._calls: Calls = calls_of(retry, cache_bytes, coding, timeout)
        headers = headers_of(api_key, coding)
        self._address = Address(url, headers, tls)
        self._http = httpx2.AsyncClient(
            base_url=url,
            headers=headers,
            timeout=timeout,
            verify=tls_of(url, tls),
            transport=transport,
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()

    async def seed(self, seed: int, recipe: str = "terrain") -> SeedDescriptor:
        """Return the pristine world of a seed: it needs no creation, and is the same for everybody.

        seed: signed, 64 bits.
        recipe: the name of a built-in recipe, or a digest.
        """
        return await self._run(self._calls.seed(seed, recipe))

    async def world(self, world_id: str) -> WorldDescriptor:
        """Return a world, as it is by now. Raises `NotFound`; `Conflict` if another generator has created it."""
        return await self._run(self._calls.world(world_id))

    async def worlds(self) -> tuple[ListedWorld, ...]:
        """Return all worlds, by id."""
        return await self._run(self._calls.worlds())

    async def create_world(
        self,
        world_id: str,
        seed: int,
        recipe: str | RecipeTree = "terrain",
        *,
        voxel_size: float | None = None,
        lods: int | None = None,
        chunk_cells: int | None = None,
    ) -> WorldDescriptor:
        """Create a world, and return it. If the same one is there already, nothing changes.

        world_id: 1 to 64 of a-z, 0-9, _ and -.
        seed: signed, 64 bits.
        recipe: the name of a built-in recipe, the digest of any, or what could be posted.
        voxel_size: metres; the server's default is 1.
        lods: levels of detail; the server's default is 12.
        chunk_cells: 16, 32 or 64; the server's default is 32.

        Raises `Conflict` if another world has the id.
        """
        options = {"voxel_size": voxel_size, "lods": lods, "chunk_cells": chunk_cells}
        return await self._run(self._calls.create_world(world_id, seed, recipe, options))

    async def delete_world(self, world_id: str) -> None:
        """Delete a world, for good. Raises `NotFound`.

        This alone is not asked for again when the connection is lost: somebody may have created it anew meanwhile.
        """
        await self._run(self._calls.delete_world(world_id))

    async def recipes(self) -> tuple[Recipe, ...]:
        """Return the built-in recipes, without their expressions."""
        return await self._run(self._calls.recipes())

    async def recipe(self, name: str) -> Recipe:
        """Return the built-in recipe of a name, or any of a digest. Raises `NotFound`."""
        return await self._run(self._calls.recipe(name))

    async def post_recipe(self, recipe: RecipeTree) -> Recipe:
        """Make a recipe known to the server, and return it; its digest names it from then on.

        recipe: an expression tree, a number, or a built-in recipe with parameters. Posting it again does no harm.
        Raises `BadRequest`, whose `values` have the `path` to the bad node.
        """
        return await self._run(self._calls.post_recipe(recipe))

    async def chunk(self, world: AnyWorld, key: Key, **options: Unpack[ChunkOptions]) -> ChunkMesh:
        """Return the mesh of a chunk; an empty one is a mesh without vertices, whose `content` is "air" or "rock".

        world: what `seed`, `world` or `create_world` returned.
        key: (lod, x, y, z).
        options: see `ChunkOptions`.

        The chunks of a seed are asked for with the descriptor's generator, so the cache needs no second look. Raises
        `Gone` when the server has got another generator; then the descriptor has to be read again.
        """
        return await self._run(self._calls.chunk(world, key, options))

    async def chunk_head(self, world: AnyWorld, key: Key, **options: Unpack[ChunkOptions]) -> ChunkHead:
        """Return what the server says of a chunk, without the chunk. It builds it all the same."""
        return await self._run(self._calls.chunk_head(world, key, options))

    def chunks(
        self,
        world: AnyWorld,
        keys: Iterable[Key | MaskedKey],
        *,
        viewer: Sequence[float] | None = None,
        **options: Unpack[ChunkOptions],
    ) -> AsyncIterator[ChunkMesh]:
        """Yield the mesh of each of many chunks, in the order in which they get ready.

        keys: (lod, x, y, z) each, or (lod, x, y, z, coarser) for one with a mask of its own; without it, that of the
            options counts. One that comes twice is yielded once. Up to 1,024 are one request, more are several.
        viewer: (x, y, z) in voxels: nearer chunks come first, over all requests.

        What a stream that breaks off has left out is asked for again, for as long as `Retry` allows without any gain. A
        chunk that fails for a reason of its own does not stop the others: that error is raised at the end.
        """
        return self._iterate(self._calls.chunks(world, keys, viewer, options))

    async def edit(self, world: WorldDescriptor, strokes: Iterable[Stroke], *, key: str | None = None) -> WrittenEdit:
        """Change a world, and return when that is durable: every chunk that is asked for from then on has it.

        strokes: applied in their order, as one: docs/edits/strokes.md has their ops, shapes and limits.
        key: another name of this edit, unique in its world, 1 to 128 visible ASCII characters: who sends the edit again
            with the same key, today or after a crash, gets the first answer, and nothing is written twice. One is made
            up if none is given; that makes this call's own attempts safe, and is forgotten with it.

        What the edit made stale is dropped from the cache. Raises `BadRequest`, whose `values` have the `path` to the
        bad stroke: then nothing is written; after `Unreachable` and `Unavailable` it may be.
        """
        return await self._run(self._calls.edit(world, strokes, key))

    def edits(self, world: WorldDescriptor, after: int = 0, limit: int | None = None) -> AsyncIterator[LoggedEdit]:
        """Yield the edits of a world behind revision `after`, in their order, up to the last one there is.

        limit: at most so many.

        They are asked for a part at a time. What they made stale is dropped from the cache. Raises `BadRequest`, whose
        `values` have the `floor`, if edits so old are not kept one by one any more.
        """
        return self._iterate(self._calls.edits(world, after, limit))

    def stream(self, world: WorldDescriptor, name: str, *, regions: Iterable[Region] | None = None) -> AsyncEditStream:
        """Return the stream of a world's edits, others' as they come. It connects when it is entered.

        name: who this is: 1 to 128 visible ASCII characters. A later stream of the same name in the same world ends
            this one.
        regions: where to look, up to 64; everywhere if none are given. Own edits may be anywhere.

        It connects again by itself, goes on where it was, and sends the edits again that were not answered. What it is
        told of is dropped from the cache. It has its own connection: `transport` is not for it.
        """
        return AsyncEditStream(self._address, self._calls, world, name, regions)

    async def is_ready(self) -> bool:
        """Return whether the server answers, and can build chunks by now."""
        return await self._run(self._calls.is_ready())

    async def wait_until_ready(self, seconds: float = READY_SECONDS) -> None:
        """Return when the server can build chunks. Raises `Unavailable` or `Unreachable` after `seconds`."""
        await self._run(self._calls.wait_until_ready(seconds))

    async def _run(self, steps: Steps[Value]) -> Value:
        call = AsyncCall(self._http, steps)
        try:
            return await call.finish()
        finally:
            await call.close()

    async def _iterate(self, steps: Steps[None]) -> AsyncIterator[Any]:
        call = AsyncCall(self._http, steps)
        try:
            while not isinstance(step := await call.advance(), Returned):
                yield step.value
        finally:
            await call.close()
