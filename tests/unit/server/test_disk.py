import asyncio
import os
import threading
import time
from contextlib import asynccontextmanager

import pytest

from chunkserver.errors import BadParameter, StoreError, StoreFull
from chunkserver.pipeline import Chunk
from chunkserver.server import disk
from chunkserver.server.cache import ChunkCache
from chunkserver.server.chunk_file import FILE_NAME, LOCK_NAME, open_claimed
from chunkserver.server.disk import DISK_BYTES_MIN, ENTRY_BYTES, DiskCache

MIB = 1 << 20
PATIENCE_SECONDS = 20


def tag(number):
    return f"{number:032x}"


def surface(size=1000):
    return Chunk("surface", os.urandom(size))


async def until(condition):
    end = time.monotonic() + PATIENCE_SECONDS
    while not condition():
        assert time.monotonic() < end, "it did not come true"
        await asyncio.sleep(0.002)


@asynccontextmanager
async def opened(folder, bytes_max=8 * MIB):
    cache = DiskCache(folder, bytes_max)
    try:
        await until(lambda: cache.ready)
        yield cache
    finally:
        await cache.close()


def damage(folder, body):
    """Change one byte of the file, in the middle of `body`."""
    path = folder / FILE_NAME
    content = bytearray(path.read_bytes())
    content[content.index(body) + len(body) // 2] ^= 1
    path.write_bytes(content)


class Kiln:
    """Builds one chunk per call."""

    def __init__(self, chunk):
        self.chunk, self.builds = chunk, 0

    async def build(self, begun):
        begun()
        self.builds += 1
        await asyncio.sleep(0)
        return self.chunk


class GatedFile:
    """A file whose reads and writes wait for a gate."""

    def __init__(self, file):
        self.file, self.gate, self.reads = file, threading.Event(), 0
        self.ruined, self.entries, self.bytes, self.evicted = False, 0, 0, 0

    def read(self, key):
        self.reads += 1
        assert self.gate.wait(PATIENCE_SECONDS)
        return self.file.read(key)

    def write(self, batch):
        assert self.gate.wait(PATIENCE_SECONDS)
        self.file.write(batch)

    def close(self):
        self.file.close()


class FullFile(GatedFile):
    """A file for which there is no room on the disk, while `full`."""

    full = True

    def write(self, batch):
        if self.full and batch:
            raise StoreFull("the disk is full")
        self.file.write(batch)


@pytest.fixture
def replaced(monkeypatch):
    """Return the files that servers get, each behind a class that is set as `kind`."""
    files = []

    def place(kind):
        def open_replaced(*arguments):
            files.append(kind(open_claimed(*arguments)))
            return files[-1]

        monkeypatch.setattr(disk, "open_claimed", open_replaced)
        return files

    return place


def test_a_restart_finds_what_was_kept(tmp_path):
    async def scenario():
        chunks = {tag(number): surface(100 * number) for number in range(50)}
        async with opened(tmp_path) as cache:
            for name, chunk in chunks.items():
                cache.keep(name, chunk)
        async with opened(tmp_path) as cache:
            assert {name: await cache.find(name) for name in chunks} == chunks
            assert await cache.find(tag(99)) is None
            assert (cache.hits, cache.misses, cache.entries, cache.dropped, cache.corrupt) == (50, 1, 50, 0, 0)
            assert sum(range(50)) * 100 < cache.bytes < 8 * MIB

    asyncio.run(scenario())


def test_what_was_kept_is_found_soon(tmp_path):
    async def scenario():
        async with opened(tmp_path) as cache:
            cache.keep(tag(1), surface())
            await until(lambda: cache.entries == 1)
            assert await cache.find(tag(1)) is not None

    asyncio.run(scenario())


def test_memory_then_disk_then_build(tmp_path):
    async def scenario():
        kiln = Kiln(surface())
        below = DiskCache(tmp_path, 8 * MIB)
        memory = ChunkCache(MIB, below)
        await until(lambda: below.ready)
        assert await memory.get_or_build(tag(1), kiln.build) is kiln.chunk
        assert await memory.get_or_build(tag(1), kiln.build) is kiln.chunk
        assert (memory.hits, memory.misses, below.hits, below.misses) == (1, 1, 0, 1)
        await memory.close()

        below = DiskCache(tmp_path, 8 * MIB)
        memory = ChunkCache(MIB, below)
        await until(lambda: below.ready)
        found = await asyncio.gather(*(memory.get_or_build(tag(1), kiln.build) for _ in range(100)))
        assert found == [kiln.chunk] * 100
        assert (memory.hits, memory.joined, memory.misses, below.hits, kiln.builds) == (0, 99, 0, 1, 1)
        assert memory.find(tag(1)) == kiln.chunk
        await memory.close()

    asyncio.run(scenario())


def test_a_damaged_entry_is_counted_and_built_anew(tmp_path, caplog):
    async def scenario():
        old, new = surface(), surface()
        async with opened(tmp_path) as cache:
            cache.keep(tag(1), old)
            cache.keep(tag(2), surface())
        damage(tmp_path, old.body)
        kiln = Kiln(new)
        below = DiskCache(tmp_path, 8 * MIB)
        memory = ChunkCache(MIB, below)
        await until(lambda: below.ready)
        assert await memory.get_or_build(tag(1), kiln.build) is new
        assert (below.corrupt, below.hits, below.misses, kiln.builds) == (1, 0, 1, 1)
        await memory.close()
        async with opened(tmp_path) as cache:
            assert await cache.find(tag(1)) == new
            assert (cache.entries, cache.corrupt) == (2, 0)

    asyncio.run(scenario())
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert f"entry {tag(1)} is damaged" in caplog.text


def test_a_damaged_entry_is_deleted_though_nobody_builds_it(tmp_path):
    async def scenario():
        old = surface()
        async with opened(tmp_path) as cache:
            cache.keep(tag(1), old)
        damage(tmp_path, old.body)
        async with opened(tmp_path) as cache:
            assert await cache.find(tag(1)) is None
            await until(lambda: cache.entries == 0)
            assert await cache.find(tag(1)) is None
            assert (cache.corrupt, cache.misses) == (1, 2)

    asyncio.run(scenario())


def test_never_over_its_bound(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "GATHER_SECONDS", 0.001)

    async def scenario():
        async with opened(tmp_path, 2 * MIB) as cache:
            for number in range(100):
                cache.keep(tag(number), surface(40_000))
                await until(lambda: cache.entries + cache.evicted == number + 1)  # noqa: B023 - awaited at once
                assert cache.bytes <= 2 * MIB
            assert cache.evicted > 50
            assert await cache.find(tag(99)) is not None
            assert await cache.find(tag(0)) is None
        assert (tmp_path / FILE_NAME).stat().st_size <= 2 * MIB

    asyncio.run(scenario())


def test_a_full_queue_drops(tmp_path, replaced):
    async def scenario():
        files = replaced(GatedFile)
        async with opened(tmp_path, 8 * MIB) as cache:
            room = 8 * MIB // 32 // (10_000 + ENTRY_BYTES)
            for number in range(room + 5):
                cache.keep(tag(number), surface(10_000))
            assert cache.dropped == 5
            files[0].gate.set()
            await until(lambda: files[0].file.entries == room)
            cache.keep(tag(room), surface(10_000))
            assert cache.dropped == 5
            cache.keep(tag(room), surface(8 * MIB // 32))
            assert cache.dropped == 6

    asyncio.run(scenario())


def test_a_full_disk_is_counted_and_told_once(tmp_path, replaced, caplog):
    async def scenario():
        files = replaced(FullFile)
        async with opened(tmp_path) as cache:
            for number in range(3):
                cache.keep(tag(number), surface())
                await until(lambda: cache.dropped == number + 1)  # noqa: B023 - awaited at once
            files[0].full = False
            cache.keep(tag(3), surface())
            await until(lambda: files[0].file.entries == 1)
            files[0].full = True
            cache.keep(tag(4), surface())
            await until(lambda: cache.dropped == 4)

    asyncio.run(scenario())
    assert [record.getMessage() for record in caplog.records] == ["the disk cache fails: the disk is full"] * 2


def test_a_slow_disk_holds_up_nobody(tmp_path, replaced):
    """Reads beyond READS_MAX do not wait: building is as fast."""

    async def scenario():
        files = replaced(GatedFile)
        async with opened(tmp_path) as cache:
            waiting = [asyncio.create_task(cache.find(tag(1))) for _ in range(disk.READS_MAX)]
            await asyncio.sleep(0)
            assert await cache.find(tag(1)) is None
            assert (cache.misses, files[0].reads <= 1) == (1, True)
            for task in waiting[1:]:
                task.cancel()
            await asyncio.wait(waiting[1:])
            files[0].gate.set()
            await waiting[0]
            assert await cache.find(tag(1)) is None
            assert files[0].reads == 2  # what nobody waits for any more is not read

    asyncio.run(scenario())


def test_the_last_who_leaves_while_the_disk_is_read_starts_no_build(tmp_path, replaced):
    async def scenario():
        files, kiln = replaced(GatedFile), Kiln(surface())
        below = DiskCache(tmp_path, 8 * MIB)
        memory = ChunkCache(MIB, below)
        await until(lambda: below.ready)
        callers = [asyncio.create_task(memory.get_or_build(tag(1), kiln.build)) for _ in range(2)]
        await until(lambda: files[0].reads == 1)
        for caller in callers:
            caller.cancel()
        await asyncio.wait(callers)
        files[0].gate.set()
        assert await memory.get_or_build(tag(1), kiln.build) is kiln.chunk
        assert (kiln.builds, memory.misses, memory.joined) == (1, 1, 1)
        await memory.close()

    asyncio.run(scenario())


def test_a_ruined_file_is_let_go(tmp_path, replaced, caplog):
    class Ruined(GatedFile):
        def read(self, _key):
            self.ruined = True
            raise StoreError("no page is where it should be")

        write = read

    async def scenario():
        replaced(Ruined)
        async with opened(tmp_path) as cache:
            kiln, memory = Kiln(surface()), ChunkCache(MIB, cache)
            assert await memory.get_or_build(tag(1), kiln.build) is kiln.chunk
            assert not cache.ready
            assert await cache.find(tag(1)) is None
            await until(lambda: not cache._writer.is_alive())
            before = cache.dropped
            cache.keep(tag(2), kiln.chunk)
            assert cache.dropped == before + 1

    asyncio.run(scenario())
    assert [record.getMessage() for record in caplog.records] == ["the disk cache fails: no page is where it should be"]


def test_no_file_no_cache(tmp_path, caplog):
    async def scenario():
        (tmp_path / FILE_NAME).mkdir()
        cache = DiskCache(tmp_path, MIB)
        await until(lambda: not cache._writer.is_alive())
        cache.keep(tag(1), surface())
        assert await cache.find(tag(1)) is None
        assert (cache.ready, cache.dropped, cache.misses, cache.entries, cache.bytes) == (False, 1, 1, 0, 0)
        await cache.close()

    asyncio.run(scenario())
    assert [record.levelname for record in caplog.records] == ["WARNING", "ERROR"]


def test_one_server_alone(tmp_path):
    async def scenario():
        async with opened(tmp_path) as cache:
            with pytest.raises(StoreError, match=f"^{tmp_path} is in use"):
                DiskCache(tmp_path, MIB)
            cache.keep(tag(1), surface())
        assert (tmp_path / LOCK_NAME).read_bytes() == b""
        async with opened(tmp_path) as cache:
            assert cache.entries == 1

    asyncio.run(scenario())


def test_a_bound_that_holds_nothing(tmp_path):
    with pytest.raises(BadParameter, match=f" {DISK_BYTES_MIN - 1} bytes") as caught:
        DiskCache(tmp_path, DISK_BYTES_MIN - 1)
    assert caught.value.values == {"bytes_max": DISK_BYTES_MIN - 1}
    assert not list(tmp_path.iterdir())
