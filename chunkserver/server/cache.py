"""Finished chunks, kept in memory up to a bound in bytes; identical requests in flight share one build.

find           memory
get_or_build   memory, then once for all who wait: disk, if there is one, then the build
"""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from chunkserver.pipeline import Chunk
from chunkserver.server.disk import DiskCache
from chunkserver.server.pool import URGENCY_DEFAULT

ENTRY_BYTES: Final = 512
"""What an entry costs besides its body: key, chunk, list and table slots. An upper bound, held by its unit test."""


Build = Callable[[Callable[[], None]], Awaitable[Chunk]]
"""Builds one chunk; calls its argument when the work has begun, from when on it is worth finishing."""


@dataclass(slots=True, eq=False)
class Kept:
    """A chunk in memory, and whether it was used since it was the oldest last time. None once it was dropped."""

    chunk: Chunk | None
    used: bool = False


@dataclass(slots=True, eq=False)
class Building:
    """A chunk on its way, the look at the disk before the build included, and how many wait for it.

    name: returns the key under which what was made is to be kept.
    chunk: never cancelled while somebody waits; to be awaited through `asyncio.shield`, or asked for by a callback.
    begun: whether it is worth finishing, even if nobody waits any more.
    """

    key: str
    urgency: int
    name: Callable[[Chunk], str]
    chunk: asyncio.Future[Chunk] = field(init=False)
    waiters: int = 0
    begun: bool = False

    def begin(self) -> None:
        """Note that the work has begun."""
        self.begun = True


class ChunkCache:
    """Chunks that were not used for long go first. One event loop owns it; nothing in it is thread-safe.

    A use is a mark and no change of order (an order of second chances). So it can be made through a `Kept`, without a
    look at any table: beside bodies of 60 KB it is memory that is not in the processor's caches that costs.
    There is no `put`: between a `find` and that, another request would start the same build.

    hits: used out of memory. joined: waited for what another request had started. misses: builds started. What is none
    of these was found on disk, which has counters of its own.
    bytes: what the kept entries weigh now, at most `bytes_max`. evicted: entries that made room.
    found_bytes: of the bodies of all hits.
    """

    def __init__(self, bytes_max: int, disk: DiskCache | None = None) -> None:
        """disk: where chunks are kept too. It is closed by `close`."""
        self.bytes_max = bytes_max
        self.disk = disk
        self.bytes = 0
        self.hits = self.joined = self.misses = self.evicted = self.found_bytes = 0
        self._kept: OrderedDict[str, Kept] = OrderedDict()
        self._building: dict[str, Building] = {}

    @property
    def entries(self) -> int:
        """Chunks in memory."""
        return len(self._kept)

    def find(self, key: str) -> Chunk | None:
        """Return the chunk named `key` if it is in memory, or None. It counts as a hit, and as used."""
        kept = self._kept.get(key)
        return None if kept is None else self.use(kept)

    def look_up(self, key: str) -> Kept | None:
        """Return what `find` would find, without counting it."""
        return self._kept.get(key)

    def use(self, kept: Kept) -> Chunk | None:
        """Return the chunk if it is in memory still, or None. It counts as a hit, and as used."""
        chunk = kept.chunk
        if chunk is not None:
            self.hits += 1
            self.found_bytes += len(chunk.body)
            kept.used = True
        return chunk

    def at_hand(self, key: str) -> bool:
        """Whether a chunk may be had without a build that was not begun: it is in memory, on its way, or on disk."""
        return key in self._kept or key in self._building or self.disk is not None

    async def get_or_build(
        self, key: str, build: Build, urgency: int = URGENCY_DEFAULT, name: Callable[[Chunk], str] | None = None
    ) -> Chunk:
        """Return the chunk named `key`, reading or building it at most once however many ask.

        name: returns the name of a chunk that was built; without it, that is `key`. A chunk that is edited meanwhile
            has another name than was asked for. Nothing is kept under a name that is not its own.

        A caller that is cancelled does not cancel the build: see `leave`. Raises what `build` raises, to everyone who
        waits; a failure is not kept.
        """
        kept = self.find(key)
        if kept is not None:
            return kept
        building = self.ask(key, build, urgency, name)
        try:
            return await asyncio.shield(building.chunk)
        finally:
            self.leave(building)

    def ask(
        self, key: str, build: Build, urgency: int = URGENCY_DEFAULT, name: Callable[[Chunk], str] | None = None
    ) -> Building:
        """Wait for the chunk named `key`, which is not in memory; it is on its way, or is now. `leave` ends the wait.

        This is what `get_or_build` is made of, for who asks for many chunks and wants no task for each.

        urgency: of `build`. A build that is less urgent and has not begun is not joined: it may be refused, or late.
        """
        building = self._building.get(key)
        if building is None or not (building.begun or building.urgency <= urgency):
            building = Building(key, urgency, name or (lambda _: key))
            building.chunk = asyncio.ensure_future(self._fill(building, build))
            self._building[key] = building  # not before: `build` may raise at once
            building.chunk.add_done_callback(partial(self._filled, building))
        else:
            self.joined += 1
        building.waiters += 1
        return building

    def leave(self, building: Building) -> None:
        """Wait no longer. When the last one leaves, what has not begun is cancelled; else it goes on into the cache."""
        building.waiters -= 1
        if not (building.waiters or building.begun or building.chunk.done()):
            self._forget(building)  # at once: who comes now must not join what is being cancelled
            building.chunk.cancel()

    def _forget(self, building: Building) -> None:
        if self._building.get(building.key) is building:
            del self._building[building.key]

    async def close(self) -> None:
        """Close the disk cache, which writes what it has been given."""
        if self.disk:
            await self.disk.close()

    def _fill(self, building: Building, build: Build) -> Awaitable[Chunk]:
        if self.disk is not None:
            return self._fill_by_disk(self.disk, building, build)
        self.misses += 1
        return build(building.begin)

    async def _fill_by_disk(self, disk: DiskCache, building: Building, build: Build) -> Chunk:
        chunk = await disk.find(building.key)
        if chunk is None:
            self.misses += 1
            chunk = await build(building.begin)
            disk.keep(building.name(chunk), chunk)
        return chunk

    def _filled(self, building: Building, chunk: asyncio.Future[Chunk]) -> None:
        """Keep what was made, before any who wait are told."""
        self._forget(building)
        if not chunk.cancelled() and chunk.exception() is None:
            self._keep(building.name(chunk.result()), chunk.result())

    def _keep(self, key: str, chunk: Chunk) -> None:
        weight = _weight(chunk)
        if weight > self.bytes_max or key in self._kept:
            return
        while self.bytes + weight > self.bytes_max:
            self._drop_oldest()
        self._kept[key] = Kept(chunk)
        self.bytes += weight

    def _drop_oldest(self) -> None:
        key, oldest = self._kept.popitem(last=False)
        if oldest.used:
            oldest.used = False
            self._kept[key] = oldest
        elif oldest.chunk is not None:
            self.bytes -= _weight(oldest.chunk)
            oldest.chunk = None
            self.evicted += 1


def _weight(chunk: Chunk) -> int:
    return len(chunk.body) + ENTRY_BYTES
