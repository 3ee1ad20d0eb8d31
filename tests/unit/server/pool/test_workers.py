import asyncio
import gc
import sys

import pytest

from chunkserver.server.pool import Tally
from chunkserver.server.pool.workers import ForkServer, Worker

SLEEPER = (sys.executable, "-c", "import signal; signal.pause()")


def test_the_first_word_of_a_worker_for_which_nobody_waits_any_more():
    async def scenario():
        idle: list[Worker] = []
        worker = Worker(Tally(), idle.append, idle.remove)
        worker.started.cancel()
        worker.arrived(7)
        assert (worker.pid, idle) == (7, [worker])

    asyncio.run(scenario())


def test_the_word_of_a_fork_server_for_which_nobody_waits_any_more(monkeypatch):
    monkeypatch.setattr("chunkserver.server.pool.workers.WARM_SECONDS_MAX", 0.0)

    async def scenario():
        fork_server = ForkServer(SLEEPER, lambda: None)
        with pytest.raises(TimeoutError):
            await fork_server.connect()
        fork_server.arrived(("of the sources", 0, 0.0))
        await fork_server.end()

    asyncio.run(scenario())


def test_a_fork_that_cannot_be_asked_for_leaves_no_socket(recwarn):
    async def scenario():
        fork_server = ForkServer(SLEEPER, lambda: None)
        fork_server._control.close()
        with pytest.raises(OSError, match="descriptor"):
            await fork_server.fork(Worker(Tally(), print, print), 0)
        await fork_server.end()

    asyncio.run(scenario())
    gc.collect()
    assert not [warning for warning in recwarn if warning.category is ResourceWarning]
