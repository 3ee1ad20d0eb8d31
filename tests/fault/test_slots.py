"""Answers of every size, and what is left of them: no memory, shared or not, and no descriptor."""

import asyncio
import itertools
import os
from pathlib import Path

import pytest
import uvloop

from chunkserver.memory import SLOT_BYTES
from tests.fault import stub
from tests.fault.pools import Load, fork_server, open_files, running, slot_bytes, until, workers
from tests.scale import count

on_both_loops = pytest.mark.parametrize(
    "run", [asyncio.new_event_loop, uvloop.new_event_loop], ids=["asyncio", "uvloop"], indirect=True
)


async def right_size(pool, size):
    assert (await pool.build(stub.ask("size", str(size)))).body == stub.body(size)


@on_both_loops
def test_answers_of_any_size_are_right_and_the_slot_is_as_large_as_before(run):
    async def scenario():
        async with running(workers=1) as pool:
            for size in (0, 1, SLOT_BYTES, SLOT_BYTES + 1, 20_000_000, 0, 60_000, 3 * SLOT_BYTES, 5):
                await right_size(pool, size)
                assert slot_bytes(workers()[0]) == slot_bytes(os.getpid()) == SLOT_BYTES

    run(scenario())


KILLS = count(1_500)
CLIENTS = 4
SIZES = (0, 60_000, 3 * SLOT_BYTES, 5, 300_000)
GROWTH_BYTES_MAX = 16 << 20
"""Of the server, over all kills. While one is waited for, each client has answers of up to 3 MB."""


def own_bytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith(("RssAnon", "RssShmem")))


def test_thousands_of_jobs_and_kills_leave_no_memory_and_no_descriptor(run):
    async def scenario():
        async with running(workers=2) as pool:
            sizes = itertools.cycle(SIZES)

            async def left(kills: int) -> tuple[list[int], int]:
                """Return how many descriptors and bytes are in use after so many kills under load."""
                load = Load(CLIENTS, lambda: right_size(pool, next(sizes)))
                async with load.running():
                    for _ in range(kills):
                        await load.kill_a_worker()
                await until(lambda: len(workers()) == 2)
                await until(lambda: slot_bytes(os.getpid()) == 2 * SLOT_BYTES)
                assert {slot_bytes(pid) for pid in workers()} == {SLOT_BYTES}
                return [open_files("self"), open_files(fork_server())], own_bytes()

            files, memory = await left(KILLS // 3)
            later_files, later_memory = await left(KILLS)
            assert later_files == files
            assert later_memory - memory < GROWTH_BYTES_MAX
            assert pool.tally.lost == KILLS // 3 + KILLS

    run(scenario())
