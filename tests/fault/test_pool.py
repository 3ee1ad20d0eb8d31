"""What the pool does beyond keeping its workers alive: order, deadlines, recycling, and what it counts."""

import asyncio
import os
import signal
from contextlib import asynccontextmanager
from functools import partial

import pytest

from chunkserver.errors import BadKey, DeadlinePassed, Overloaded
from chunkserver.server.pool import URGENCY_DEFAULT, BuildFault, Limits
from chunkserver.server.pool.pool import LOSSES_MAX
from chunkserver.worker import JOBS_PER_MEASURE
from tests.fault import stub
from tests.fault.pools import alive, fork_server, right, running, until, workers


@asynccontextmanager
async def blocked(folder, limits=None):
    """A pool whose only worker is busy until the function that is yielded beside it is called."""
    async with running(workers=1, limits=limits) as pool:
        over = folder / "over"
        busy = asyncio.ensure_future(pool.build(stub.ask("wait", str(over))))
        await until(lambda: pool.busy == 1)
        yield pool, over.touch
        await busy


def ended(pids):
    return not any(map(alive, pids))


async def queued(pool, count):
    """Return when so many jobs wait."""
    await until(lambda: pool.waiting == count)


def test_the_urgent_are_built_first_then_the_near_then_the_coarse(run, tmp_path):
    async def scenario():
        async with blocked(tmp_path) as (pool, go_on):
            begun = []

            def job(name, urgency, distance, lod):
                request = stub.ask("answer", x=0, lod=lod)
                return pool.build(request, lambda: begun.append(name), urgency=urgency, distance=distance)

            jobs = [
                job("last", 7, 0.0, 9),
                job("far", 3, 9.0, 9),
                job("fine", 3, 0.0, 0),
                job("coarse", 3, 0.0, 1),
                job("urgent", 0, 9.0, 0),
            ]
            await queued(pool, len(jobs))
            go_on()
            await asyncio.gather(*jobs)
            assert begun == ["urgent", "coarse", "fine", "far", "last"]

    run(scenario())


def test_who_is_more_urgent_takes_the_place_of_another(run, tmp_path):
    async def scenario():
        async with blocked(tmp_path, Limits(jobs_waiting=1)) as (pool, go_on):
            assert not pool.refuses(7)
            displaced = asyncio.ensure_future(pool.build(stub.ask(x=1)))
            await queued(pool, 1)
            assert pool.refuses(URGENCY_DEFAULT)
            assert pool.refuses(7, lod=9)
            assert not pool.refuses(URGENCY_DEFAULT, lod=1)
            assert not pool.refuses(URGENCY_DEFAULT - 1)
            with pytest.raises(Overloaded, match="1 requests are waiting"):
                await pool.build(stub.ask(x=2))
            urgent = asyncio.ensure_future(pool.build(stub.ask(x=3), urgency=1))
            with pytest.raises(Overloaded):
                await displaced
            assert (pool.waiting, pool.tally.refused) == (1, 2)
            go_on()
            assert await urgent == stub.answer(3)

    run(scenario())


def test_a_worker_gives_up_a_build_that_is_too_late(run):
    async def scenario():
        async with running(workers=1, limits=Limits(answer_seconds=0.3)) as pool:
            with pytest.raises(DeadlinePassed):
                await pool.build(stub.ask("stages", "0.4"))
            assert pool.busy == 1, "the caller does not wait for the end of a stage"
            await until(lambda: pool.busy == 0, 0.35)
            assert (pool.tally.expired, pool.tally.failed, pool.tally.done) == (1, 1, 0)
            await right(pool, 1)

    run(scenario())


def test_a_worker_that_has_grown_is_replaced_and_there_are_never_fewer(run):
    size = 1 << 18

    async def scenario():
        async with running(limits=Limits(worker_bytes=size * JOBS_PER_MEASURE // 2)) as pool:
            before, fewest, over = set(workers()), 2, False

            async def client(x):
                while not over:
                    assert await pool.build(stub.ask("grow", str(size), x)) == stub.answer(x)

            async def look():
                nonlocal fewest
                while not over:
                    fewest = min(fewest, sum(worker.pid != 0 for worker in pool._workers))
                    assert len(workers()) <= 3
                    await asyncio.sleep(0)

            async with asyncio.TaskGroup() as tasks:
                for x in range(3):
                    tasks.create_task(client(x))
                tasks.create_task(look())
                await until(lambda: pool.tally.recycled >= 4)
                over = True
            await until(lambda: len(workers()) == 2)
            assert not before & set(workers())
            assert fewest == 2
            assert (pool.tally.lost, pool.tally.retried, pool.tally.failed) == (0, 0, 0)

    run(scenario())


def test_what_goes_with_all_workers_and_the_fork_server_is_no_loss(run, tmp_path):
    async def scenario():
        async with running(workers=2) as pool:
            over = tmp_path / "over"
            jobs = [asyncio.ensure_future(pool.build(stub.ask("wait", str(over), x))) for x in range(2)]
            for _ in range(LOSSES_MAX):
                await until(lambda: pool.ready and pool.busy == 2)
                group = fork_server(), *workers()
                for pid in reversed(group):
                    os.kill(pid, signal.SIGKILL)
                await until(partial(ended, group))
            over.touch()
            assert await asyncio.gather(*jobs) == [stub.answer(x) for x in range(2)]

    run(scenario())


def test_everything_is_counted(run, tmp_path):
    async def scenario():
        async with running(workers=1, limits=Limits(answer_seconds=2.0)) as pool:
            await right(pool, 1, 2, 3)
            await pool.build(stub.ask("stages", "0.01"))
            for deed, error in (("refuse", BadKey), ("fail", BuildFault)):
                with pytest.raises(error):
                    await pool.build(stub.ask(deed))
            assert await pool.build(stub.ask("die", str(tmp_path / "died"), 5)) == stub.answer(5)
            tally = pool.tally
            counts = tally.done, tally.failed, tally.refused, tally.expired, tally.retried
            assert counts == (5, 2, 0, 0, 1)
            assert (tally.lost, tally.hung, tally.recycled) == (1, 0, 0)
            times = {stage: sum(histogram.counts) for stage, histogram in tally.seconds.items()}
            assert times == {"queue": 8, "field": 1, "mesh": 1, "encode": 1, "build": 5}
            assert 0.01 <= tally.seconds["mesh"].total < tally.seconds["build"].total - 0.02

    run(scenario())
