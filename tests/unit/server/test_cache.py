import asyncio
import tracemalloc

import pytest

from chunkserver.pipeline import Chunk
from chunkserver.server.cache import ENTRY_BYTES, ChunkCache


class Oven:
    """Builds one chunk per call, when `heat` is set."""

    def __init__(self, size=100, error=None):
        self.size, self.error, self.builds = size, error, 0
        self.heat = asyncio.Event()
        self.heat.set()
        self.lit = True

    async def build(self, begun):
        self.builds += 1
        if self.lit:
            begun()
        await self.heat.wait()
        if self.error:
            raise self.error
        return Chunk("surface", bytes(self.size))


def room_for(entries, size=100):
    return entries * (size + ENTRY_BYTES)


def test_a_second_request_is_a_hit():
    async def scenario():
        cache, oven = ChunkCache(room_for(1)), Oven()
        first = await cache.get_or_build("a", oven.build)
        assert await cache.get_or_build("a", oven.build) is first
        assert (oven.builds, cache.hits, cache.joined, cache.misses) == (1, 1, 0, 1)
        assert (cache.entries, cache.found_bytes) == (1, 100)

    asyncio.run(scenario())


def test_the_least_recently_used_goes_first():
    async def scenario():
        cache, oven = ChunkCache(room_for(2)), Oven()
        for key in "abacb":  # c drives b out, not a; then b drives a out
            await cache.get_or_build(key, oven.build)
        assert oven.builds == 4
        await cache.get_or_build("c", oven.build)
        assert oven.builds == 4
        await cache.get_or_build("a", oven.build)
        assert oven.builds == 5
        assert (cache.entries, cache.evicted) == (2, 3)

    asyncio.run(scenario())


def test_never_over_its_bound():
    async def scenario():
        cache = ChunkCache(10_000)
        for size in (0, 1, 5000, 4000, 9000, 100, 3000, 10_000 - ENTRY_BYTES):
            await cache.get_or_build(str(size), Oven(size).build)
            assert 0 < cache.bytes <= 10_000
        assert cache.bytes == 10_000

    asyncio.run(scenario())


@pytest.mark.parametrize("bytes_max", [0, 10_000])
def test_what_is_larger_than_the_bound_is_served_but_not_kept(bytes_max):
    async def scenario():
        cache, oven = ChunkCache(bytes_max), Oven(bytes_max - ENTRY_BYTES + 1 if bytes_max else 0)
        await cache.get_or_build("small", Oven(0).build)
        before = cache.bytes
        for _ in range(2):
            assert len((await cache.get_or_build("large", oven.build)).body) == oven.size
        assert oven.builds == 2
        assert cache.bytes == before  # and it drove nothing out

    asyncio.run(scenario())


def test_requests_in_flight_share_one_build():
    async def scenario():
        cache, oven = ChunkCache(room_for(9)), Oven()
        oven.heat.clear()
        callers = [asyncio.create_task(cache.get_or_build("a", oven.build)) for _ in range(100)]
        other = asyncio.create_task(cache.get_or_build("b", Oven().build))
        await other  # not held up by the build of "a"
        oven.heat.set()
        chunks = await asyncio.gather(*callers)
        assert all(chunk is chunks[0] for chunk in chunks)
        assert (oven.builds, cache.hits, cache.joined, cache.misses) == (1, 0, 99, 2)

    asyncio.run(scenario())


def test_a_caller_who_leaves_takes_the_build_from_nobody():
    async def scenario():
        cache, oven = ChunkCache(room_for(9)), Oven()
        oven.heat.clear()
        first, second = (asyncio.create_task(cache.get_or_build("a", oven.build)) for _ in range(2))
        await asyncio.sleep(0)
        first.cancel()
        await asyncio.wait([first])
        oven.heat.set()
        assert (await second).body == bytes(100)
        assert first.cancelled()
        assert oven.builds == 1

    asyncio.run(scenario())


async def leave(caller):
    caller.cancel()
    await asyncio.wait([caller])


def test_the_last_who_leaves_cancels_a_build_that_has_not_begun():
    async def scenario():
        cache, oven = ChunkCache(room_for(9)), Oven()
        oven.heat.clear()
        oven.lit = False
        callers = [asyncio.create_task(cache.get_or_build("a", oven.build)) for _ in range(3)]
        await asyncio.sleep(0)
        for caller in callers[:-1]:
            await leave(caller)
        later = asyncio.create_task(cache.get_or_build("a", oven.build))
        await asyncio.sleep(0)
        assert (oven.builds, cache.misses) == (1, 1)
        await leave(later)
        callers[-1].cancel()
        another = asyncio.create_task(cache.get_or_build("a", oven.build))  # comes while the build is being cancelled
        await asyncio.wait([callers[-1]])
        oven.heat.set()
        assert (await another).body == bytes(100)
        assert (oven.builds, cache.misses) == (2, 2)
        assert len(asyncio.all_tasks()) == 1

    asyncio.run(scenario())


def test_a_build_that_has_begun_goes_on_into_the_cache():
    async def scenario():
        cache, oven = ChunkCache(room_for(9)), Oven()
        oven.heat.clear()
        caller = asyncio.create_task(cache.get_or_build("a", oven.build))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        await leave(caller)
        assert cache.find("a") is None
        oven.heat.set()
        assert (await cache.get_or_build("a", oven.build)).body == bytes(100)
        assert cache.find("a") is not None
        assert oven.builds == 1

    asyncio.run(scenario())


def test_a_failure_reaches_all_who_wait_and_is_not_kept():
    async def scenario():
        cache, oven = ChunkCache(room_for(9)), Oven(error=ValueError("burnt"))
        oven.heat.clear()
        callers = [asyncio.create_task(cache.get_or_build("a", oven.build)) for _ in range(3)]
        await asyncio.sleep(0)
        oven.heat.set()
        answers = await asyncio.gather(*callers, return_exceptions=True)
        assert [type(answer) for answer in answers] == [ValueError] * 3
        oven.error = None
        assert (await cache.get_or_build("a", oven.build)).content == "surface"
        assert oven.builds == 2
        assert cache.bytes == room_for(1)

    asyncio.run(scenario())


def test_a_build_that_raises_at_once_is_in_nobodys_way():
    def refuse(_begun):
        raise ValueError("at once")

    async def scenario():
        cache, oven = ChunkCache(room_for(1)), Oven()
        with pytest.raises(ValueError, match="at once"):
            await cache.get_or_build("a", refuse)
        assert (await cache.get_or_build("a", oven.build)).content == "surface"

    asyncio.run(scenario())


def test_an_entry_weighs_no_more_than_it_is_charged():
    async def scenario():
        count = 4096
        cache, keys = ChunkCache(room_for(count, 1)), (f"{number:032x}" for number in range(count))
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        for key in keys:
            await cache.get_or_build(key, Oven(1).build)
        after, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert cache.bytes == room_for(count, 1)
        assert 0.25 * cache.bytes < after - before < cache.bytes

    asyncio.run(scenario())


def test_what_was_used_since_has_a_second_chance_and_the_rest_goes_oldest_first():
    async def scenario():
        cache, build = ChunkCache(room_for(3)), Oven().build
        for key in "abc":
            await cache.get_or_build(key, build)
        kept = cache.look_up("a")
        assert kept is not None
        assert cache.use(kept) is kept.chunk
        await cache.get_or_build("d", build)
        assert [cache.look_up(key) is not None for key in "abcd"] == [True, False, True, True]
        await cache.get_or_build("e", build)
        assert [cache.look_up(key) is not None for key in "acde"] == [True, False, True, True]
        await cache.get_or_build("f", build)
        assert (cache.look_up("a"), cache.use(kept)) == (None, None)
        assert (cache.entries, cache.evicted, cache.hits) == (3, 3, 1)

    asyncio.run(scenario())


def test_a_less_urgent_build_is_not_joined_before_it_has_begun():
    async def scenario():
        cache, slow, quick = ChunkCache(room_for(1)), Oven(), Oven()
        slow.lit = False
        slow.heat.clear()
        late = asyncio.create_task(cache.get_or_build("a", slow.build, urgency=7))
        await asyncio.sleep(0)
        same = asyncio.create_task(cache.get_or_build("a", slow.build, urgency=7))
        await asyncio.sleep(0)
        urgent = await asyncio.wait_for(cache.get_or_build("a", quick.build, urgency=0), 10)
        assert (slow.builds, quick.builds, cache.joined, late.done()) == (1, 1, 1, False)
        slow.heat.set()
        assert await late is await same
        assert cache.find("a") is urgent
        assert (cache.entries, cache.bytes) == (1, room_for(1))

    asyncio.run(scenario())


def test_what_has_gone_on_meanwhile_is_kept_under_its_own_name():
    async def scenario():
        cache, oven = ChunkCache(room_for(2)), Oven()
        made = await cache.get_or_build("r1", oven.build, name=lambda chunk: f"r{2 if chunk.body else 0}")
        assert cache.find("r1") is None
        assert cache.find("r2") is made

    asyncio.run(scenario())
