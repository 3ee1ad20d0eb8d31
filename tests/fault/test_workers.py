"""Workers that die, hang, are stopped or left alone: every request is answered, rightly or with the right error."""

import asyncio
import itertools
import logging
import os
import random
import signal
import sys

import pytest
import uvloop

from chunkserver.errors import BadKey, DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.server.pool import BuildFault, Limits, Pool
from chunkserver.server.pool.pool import LOSSES_MAX, RETRY_SECONDS
from tests.fault import stub
from tests.fault.pools import Load, alive, children, fork_server, right, running, until, workers
from tests.scale import count

on_both_loops = pytest.mark.parametrize(
    "run", [asyncio.new_event_loop, uvloop.new_event_loop], ids=["asyncio", "uvloop"], indirect=True
)


@on_both_loops
def test_everyone_gets_the_own_answer(run, caplog):
    async def scenario():
        async with running(workers=3) as pool:
            assert len(workers()) == 3
            await right(pool, *range(100))
            assert len(workers()) == 3

    run(scenario())
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


def test_an_idle_worker_that_is_killed_gets_no_more_jobs(run):
    async def scenario():
        async with running() as pool:
            before = workers()
            for pid in before:
                os.kill(pid, signal.SIGKILL)
            await until(lambda: len(set(workers()) - set(before)) == 2)
            await right(pool, *range(10))

    run(scenario())


@on_both_loops
def test_random_workers_are_killed_under_load_and_nobody_notices(run, caplog):
    kills, numbers = count(1_000), itertools.count()

    async def scenario():
        async with running() as pool:

            async def ask() -> None:
                deed = stub.ask("sleep", f"{random.uniform(0.005, 0.02):.4f}", next(numbers))
                assert await pool.build(deed) == stub.answer(deed.key.x)

            load = Load(6, ask)
            async with load.running():
                for _ in range(kills):
                    await load.kill_a_worker()

    run(scenario())
    assert sum("is lost" in record.message for record in caplog.records) == kills


def test_a_request_whose_worker_dies_is_tried_once_more(run, tmp_path):
    async def scenario():
        async with running() as pool:
            marker = tmp_path / "died"
            assert await pool.build(stub.ask("die", str(marker), 5)) == stub.answer(5)
            assert marker.exists()

    run(scenario())


def test_a_request_that_kills_its_workers_is_refused_and_takes_no_other_with_it(run, caplog):
    async def scenario():
        async with running() as pool:
            slow = [asyncio.ensure_future(pool.build(stub.ask("sleep", "0.02", x))) for x in range(20)]
            with pytest.raises(WorkerLost) as refused:
                await pool.build(stub.ask("die", x=3))
            assert refused.value.values == {"key": [0, 3, 0, 0], "losses": LOSSES_MAX}
            assert await asyncio.gather(*slow) == [stub.answer(x) for x in range(20)]
            await until(lambda: len(workers()) == 2)

    run(scenario())
    assert sum("is lost while it built" in record.message for record in caplog.records) == LOSSES_MAX


def test_a_request_that_hangs_its_workers_is_refused_and_takes_no_other_with_it(run, caplog, tmp_path):
    async def scenario():
        async with running(limits=Limits(build_seconds=1.0)) as pool:
            before, marker = set(workers()), tmp_path / "hangs"
            hung = asyncio.ensure_future(pool.build(stub.ask("hang", str(marker), 3)))
            await until(lambda: marker.exists() and marker.read_text())
            first = int(marker.read_text())
            await right(pool, *range(20))
            assert not hung.done()
            with pytest.raises(WorkerLost, match="took too long") as refused:
                await hung
            assert refused.value.values == {"key": [0, 3, 0, 0], "losses": LOSSES_MAX}
            await until(lambda: len(workers()) == 2)
            assert first in before - set(workers())
            await right(pool, *range(20))
            assert (pool.tally.hung, pool.tally.lost, pool.tally.retried) == (LOSSES_MAX, LOSSES_MAX, LOSSES_MAX - 1)

    run(scenario())
    assert sum("it is killed" in record.message for record in caplog.records) == LOSSES_MAX


def test_the_job_of_a_worker_that_is_stopped_is_tried_once_more(run):
    async def scenario():
        async with running(limits=Limits(build_seconds=0.5)) as pool:
            stopped = workers()[0]
            os.kill(stopped, signal.SIGSTOP)
            await right(pool, *range(20))
            await until(lambda: len(workers()) == 2)
            assert stopped not in workers()
            assert (pool.tally.hung, pool.tally.retried) == (1, 1)

    run(scenario())


@on_both_loops
def test_a_caller_who_leaves_does_not_spoil_the_pipe(run):
    async def scenario():
        async with running(workers=1) as pool:
            before = workers()
            for x in range(20):
                leaver = asyncio.ensure_future(pool.build(stub.ask("sleep", "0.01", x)))
                await asyncio.sleep(0)
                leaver.cancel()
                await right(pool, 1000 + x)
                assert leaver.cancelled()
            assert workers() == before, "its answer was read and dropped"

    run(scenario())


def test_a_caller_who_leaves_the_queue_frees_the_place_and_is_not_built(run, tmp_path):
    async def scenario():
        async with running(workers=1, limits=Limits(jobs_waiting=2)) as pool:
            over = tmp_path / "over"
            busy = asyncio.ensure_future(pool.build(stub.ask("wait", str(over))))
            await asyncio.sleep(0)
            marker = tmp_path / "built"
            waiting = [asyncio.ensure_future(pool.build(stub.ask("die", str(marker)))) for _ in range(2)]
            await asyncio.sleep(0)
            with pytest.raises(Overloaded) as refused:
                await pool.build(stub.ask())
            assert refused.value.values == {"waiting": 2}
            for task in waiting:
                task.cancel()
            await asyncio.wait(waiting)
            later = asyncio.create_task(right(pool, 1, 2))
            await asyncio.sleep(0)
            over.touch()
            await later
            await busy
            assert not marker.exists()

    run(scenario())


def test_who_waits_too_long_is_told(run, tmp_path):
    async def scenario():
        async with running(workers=1, limits=Limits(answer_seconds=0.2)) as pool:
            marker = tmp_path / "hangs"
            hung = asyncio.ensure_future(pool.build(stub.ask("hang", str(marker))))
            await until(marker.exists)
            for late in (pool.build(stub.ask()), hung):
                with pytest.raises(DeadlinePassed, match="no answer within"):
                    await late

    run(scenario())


def test_errors_keep_their_class_and_values_and_the_worker_lives(run, caplog):
    async def scenario():
        async with running(workers=1) as pool:
            before = workers()
            with pytest.raises(BadKey) as bad:
                await pool.build(stub.ask("refuse"))
            assert bad.value.values == {"x": 7}
            with pytest.raises(BuildFault) as fault:
                await pool.build(stub.ask("fail", x=4))
            assert "a fault of ours" not in str(fault.value), "what went wrong inside is not the caller's"
            assert fault.value.values == {"key": [0, 4, 0, 0]}
            assert workers() == before

    run(scenario())
    (record,) = (record for record in caplog.records if record.levelno >= logging.WARNING)
    assert "RuntimeError: a fault of ours" in record.message
    assert "\n" not in record.message


def test_the_fork_server_is_killed_and_all_goes_on(run):
    async def scenario():
        async with running() as pool:
            old = fork_server(), *workers()
            slow = [asyncio.ensure_future(pool.build(stub.ask("sleep", "0.05", x))) for x in range(10)]
            await asyncio.sleep(0)
            os.kill(old[0], signal.SIGKILL)
            await until(lambda: not pool.ready)
            assert await asyncio.gather(*slow) == [stub.answer(x) for x in range(10)]
            await until(lambda: pool.ready)
            assert not any(alive(pid) for pid in old)

    run(scenario())


def test_a_job_has_lost_nothing_when_its_worker_goes_with_the_fork_server(run, tmp_path):
    async def scenario():
        async with running(workers=1) as pool:
            over = tmp_path / "over"
            job = asyncio.ensure_future(pool.build(stub.ask("wait", str(over), 5)))
            for _ in range(LOSSES_MAX):
                await until(lambda: pool.ready)
                os.kill(fork_server(), signal.SIGKILL)
                await until(lambda: not pool.ready)
            over.touch()
            assert await job == stub.answer(5)

    run(scenario())


def test_a_fork_server_that_is_stopped_is_replaced(run, monkeypatch):
    monkeypatch.setattr("chunkserver.server.pool.workers.START_SECONDS_MAX", 0.3)

    async def scenario():
        async with running() as pool:
            old = fork_server()
            os.kill(old, signal.SIGSTOP)
            os.kill(workers()[0], signal.SIGKILL)
            await until(lambda: not alive(old))
            await right(pool, *range(10))

    run(scenario())


def test_a_fork_server_that_does_not_start_is_tried_again_ever_later(run, caplog):
    def failures() -> list[float]:
        return [record.created for record in caplog.records if "ended before it was warm" in record.message]

    async def scenario():
        pool = Pool(2, Limits(answer_seconds=0.1), (sys.executable, "-S", "-c", "raise SystemExit(3)"))
        await pool.start()
        with pytest.raises(DeadlinePassed):
            await pool.build(stub.ask())
        await until(lambda: len(failures()) == 4)
        assert not pool.ready
        await pool.close()
        assert not children(os.getpid())

    run(scenario())
    pauses = [late - early for early, late in itertools.pairwise(failures())]
    assert all(pause >= RETRY_SECONDS * 2**failure for failure, pause in enumerate(pauses))


def test_a_fork_server_with_other_sources_than_the_server_builds_nothing(run, caplog):
    code = "from chunkserver.worker import *; main(warm_up=lambda: Warmth('of another version', 0, 0.0))"

    async def scenario():
        pool = Pool(2, command=(sys.executable, "-c", code))
        await pool.start()
        await until(lambda: "no longer those that this server runs" in caplog.text)
        assert not pool.ready
        await pool.close()

    run(scenario())


def test_closing_ends_what_waits_and_what_hangs(run, tmp_path):
    async def scenario():
        async with running(workers=1) as pool:
            marker = tmp_path / "hangs"
            jobs = [asyncio.ensure_future(pool.build(stub.ask("hang", str(marker)))) for _ in range(3)]
            await until(marker.exists)
            await pool.close()
            for job in [*jobs, asyncio.ensure_future(pool.build(stub.ask()))]:
                with pytest.raises(Unavailable, match="stopping"):
                    await job

    run(scenario())
