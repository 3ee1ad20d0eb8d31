"""Pools of stub workers, and what the operating system knows of their processes."""

import asyncio
import os
import random
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from chunkserver.server.pool import Limits, Pool
from tests.fault import stub

PATIENCE_SECONDS = 30.0


def state_and_parent(pid: int) -> tuple[str, int]:
    """Return the state letter of a pid ("X" if there is none) and its parent."""
    try:
        state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
    except (FileNotFoundError, ProcessLookupError):
        return "X", 0
    return state, int(parent)


def alive(pid: int) -> bool:
    """Whether it runs; one that has ended and that its parent has not asked for yet does not."""
    return state_and_parent(pid)[0] not in "ZX"


def children(parent: int, zombies: bool = False) -> list[int]:
    """Return the pids of the living children of `parent`, or of its zombies."""
    states = {int(path.name): state_and_parent(int(path.name)) for path in Path("/proc").glob("[0-9]*")}
    return sorted(pid for pid, (state, of) in states.items() if of == parent and (state in "ZX") == zombies)


def fork_server() -> int:
    (pid,) = children(os.getpid())
    return pid


def workers() -> list[int]:
    return children(fork_server())


def open_files(pid: int | str) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


def slot_bytes(pid: int) -> int:
    """Return how much memory a process has open for bodies that workers share with the server."""
    total = 0
    for path in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # the folder's own descriptor
            total += path.stat().st_size if str(path.readlink()).startswith("/memfd:chunkserver-slot") else 0
    return total


async def until(condition: Callable[[], object], seconds: float = PATIENCE_SECONDS) -> None:
    """Return as soon as `condition` holds; fail after `seconds`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        await asyncio.sleep(0.005)


@asynccontextmanager
async def running(workers: int = 2, limits: Limits | None = None, command=stub.COMMAND) -> AsyncIterator[Pool]:
    """A pool of stubs, ready; closed at the end, and nothing of it left."""
    pool = Pool(workers, limits or Limits(), command)
    await pool.start()
    assert not pool.ready
    try:
        async with asyncio.timeout(PATIENCE_SECONDS):
            await pool.wait_ready()
        yield pool
    finally:
        await pool.close()
    assert not children(os.getpid()), "a closed pool leaves no process"


async def right(pool: Pool, *numbers: int) -> None:
    """Ask for these all at once; each gets its own answer."""
    answers = await asyncio.gather(*(pool.build(stub.ask(x=x)) for x in numbers))
    assert answers == [stub.answer(x) for x in numbers]


class Load:
    """Clients that ask one thing after the other, each as soon as it has its answer, until `over`."""

    def __init__(self, clients: int, ask: Callable[[], Awaitable[None]]) -> None:
        self.answers = [0] * clients
        self._ask = ask
        self._over = False

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        async with asyncio.TaskGroup() as tasks:
            for client in range(len(self.answers)):
                tasks.create_task(self._run(client))
            yield
            self._over = True

    async def kill_a_worker(self, number: int = signal.SIGKILL) -> None:
        """Kill one, then wait for an answer to each client: a job that loses two workers is a test of its own."""
        await until(workers)
        os.kill(random.choice(workers()), number)
        before = list(self.answers)
        await until(lambda: all(now > old for now, old in zip(self.answers, before, strict=True)))

    async def _run(self, client: int) -> None:
        while not self._over:
            await self._ask()
            self.answers[client] += 1
