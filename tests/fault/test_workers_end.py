"""What workers share with the server, what the signals of its group do to them, and what is left when it has ended."""

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

import pytest

from chunkserver.errors import WorkerLost
from chunkserver.server.pool.pool import LOSSES_MAX
from chunkserver.server.pool.workers import FORK_SERVER
from tests.fault import stub
from tests.fault.pools import alive, children, fork_server, open_files, right, running, until, workers
from tests.scale import TORTURE


def test_a_stop_of_the_whole_group_is_the_servers_to_answer(run):
    async def scenario():
        async with running() as pool:
            everyone = fork_server(), *workers()
            slow = [asyncio.ensure_future(pool.build(stub.ask("sleep", "0.1", x))) for x in range(4)]
            await asyncio.sleep(0)
            for signal_number in (signal.SIGINT, signal.SIGTERM):
                os.killpg(everyone[0], signal_number)
            assert await asyncio.gather(*slow) == [stub.answer(x) for x in range(4)]
            assert (fork_server(), *workers()) == everyone

    run(scenario())


def test_a_worker_has_its_pipe_its_slot_the_arena_and_nothing_else_of_the_server(run):
    async def scenario():
        async with running(workers=3) as pool:
            os.kill(workers()[0], signal.SIGKILL)
            await until(lambda: len(workers()) == 3)
            for pid in workers():
                files = [str(link.readlink()) for link in Path(f"/proc/{pid}/fd").iterdir()]
                assert len([file for file in files if file.startswith("socket:")]) == 1
                shared = sorted(file.split()[0] for file in files if file.startswith("/memfd:"))
                assert shared == ["/memfd:chunkserver-arena", "/memfd:chunkserver-slot"]
                assert len(files) == 6, "stdin, stdout, stderr, the pipe, the slot and the arena"
            told = json.loads((await pool.build(stub.ask("tell"))).body)
            assert told["pid"] in workers()
            web = {"asyncio", "fastapi", "starlette", "uvicorn", "uvloop", "httptools", "typer"}
            assert not web & set(told["modules"])

    run(scenario())


def test_no_descriptor_or_zombie_is_left_by_200_lost_workers(run):
    async def scenario():
        async with running(workers=2) as pool:
            ours, theirs = open_files("self"), open_files(fork_server())
            for _ in range(200 // LOSSES_MAX):
                with pytest.raises(WorkerLost):
                    await pool.build(stub.ask("die"))
            await right(pool, 1, 2)
            await until(lambda: len(workers()) == 2)
            await until(lambda: (open_files("self"), open_files(fork_server())) == (ours, theirs))
            assert not children(fork_server(), zombies=True)

    run(scenario())


GONE_SECONDS_MAX = 1.0 if TORTURE else 5.0
"""From the end of a server to the end of the last process of it. One second is the promise, on an idle machine."""
SERVER = """
import asyncio, sys
from tests.fault import stub
from chunkserver.server.pool import Pool

async def serve():
    pool = Pool(2, command=stub.COMMAND)
    await pool.start()
    await pool.wait_ready()
    hung = asyncio.ensure_future(pool.build(stub.ask("hang", sys.argv[1])))
    await asyncio.sleep(600)

asyncio.run(serve())
"""
COLD_SERVER = """
import asyncio, sys
from chunkserver.server.pool import Pool

WARM_UP = (
    "import pathlib, time; from chunkserver.worker import main; "
    f"main(warm_up=lambda: (pathlib.Path({sys.argv[1]!r}).touch(), time.sleep(600)))"
)

async def serve():
    await Pool(1, command=(sys.executable, "-c", WARM_UP)).start()
    await asyncio.sleep(600)

asyncio.run(serve())
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize(("code", "left"), [(SERVER, 3), (COLD_SERVER, 1)], ids=["hung", "warming"])
def test_nothing_outlives_the_server(run, how, code, left, tmp_path):
    async def scenario():
        marker = tmp_path / "marker"
        server = await asyncio.create_subprocess_exec(sys.executable, "-c", code, str(marker), cwd=stub.ROOT)
        await until(marker.exists)
        (forker,) = children(server.pid)
        everyone = [forker, *children(forker)]
        assert len(everyone) == left
        server.send_signal(how)
        assert await server.wait() == -how
        await until(lambda: not any(alive(pid) for pid in everyone), GONE_SECONDS_MAX)

    run(scenario())


def test_what_lies_in_the_working_directory_is_not_imported(run, tmp_path, monkeypatch):
    (tmp_path / "numba.py").write_text("raise SystemExit('this is not Numba')")
    monkeypatch.chdir(tmp_path)

    async def scenario():
        async with running(workers=1, command=FORK_SERVER) as pool:
            assert pool.ready

    run(scenario())
