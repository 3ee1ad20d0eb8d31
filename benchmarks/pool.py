"""Our pool beside `concurrent.futures.ProcessPoolExecutor`, which the same event loop drives by `run_in_executor`.

Two workers each, the same request to both, and an answer of 60 KB that takes no time to make: this is what the way to a
worker and back adds to each chunk. CPU is that of the server's process, all its threads, without its workers. How many
times ours it is stands behind the executor's figures.
"""

import asyncio
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import cycle, islice
from multiprocessing import get_context
from typing import Final, NamedTuple

import uvloop

from benchmarks.measure import US, Figure, Line, Scale, in_turns
from chunkserver.grid import ChunkKey
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.pool import Pool
from chunkserver.worker import Warmth, main

WORKERS: Final = 2
IN_FLIGHT: Final = (16, 1)
BODY: Final = bytes(60_000)
COMMAND: Final = (sys.executable, "-P", "-m", "benchmarks.pool")

Ask = Callable[[ChunkRequest], Awaitable[object]]


class Turn(NamedTuple):
    """One round."""

    tasks: int
    seconds: float
    cpu_seconds: float


FIGURES: Final[dict[tuple[str, str], Callable[[Turn], float]]] = {
    ("tasks", "1/s"): lambda turn: turn.tasks / turn.seconds,
    ("one task", "us"): lambda turn: turn.seconds / turn.tasks * US,
    ("server CPU", "us"): lambda turn: turn.cpu_seconds / turn.tasks * US,
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield lines of ours, and of the executor's beside it, for each number of tasks in flight."""
    world = WorldRecipe(7, builtin("terrain"))
    keys = (ChunkKey(0, x, 0, 0) for x in range(scale.chunks))
    requests = tuple(islice(cycle([ChunkRequest(world, key) for key in keys]), scale.warm_requests))
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner, _both(runner) as (ours, theirs):
        for in_flight in IN_FLIGHT:
            candidates = {
                name: partial(_run_turn, runner, ask, requests, in_flight)
                for name, ask in (("", ours), (", standard executor", theirs))
            }
            results = in_turns(candidates, scale.rounds)
            for name, turns in results.items():
                peers = results[""] if name else []
                subject = f"{in_flight} in flight" if in_flight > 1 else "one at a time"
                yield Line(subject + name, tuple(_figure(figure, turns, peers) for figure in FIGURES))


@contextmanager
def _both(runner: asyncio.Runner) -> Iterator[tuple[Ask, Ask]]:
    """Yield how ours is asked, and how the executor is."""
    pool = Pool(WORKERS, command=COMMAND)
    with ProcessPoolExecutor(WORKERS, get_context("forkserver")) as executor:
        try:
            runner.run(_start(pool))
            yield pool.build, lambda request: runner.get_loop().run_in_executor(executor, answer, request)
        finally:
            runner.run(pool.close())


async def _start(pool: Pool) -> None:
    await pool.start()
    await pool.wait_ready()


def answer(_request: ChunkRequest) -> bytes:
    """Be a worker's task."""
    return BODY


def _build(request: ChunkRequest, _stage: object) -> Chunk:
    return Chunk("surface", answer(request))


def _run_turn(runner: asyncio.Runner, ask: Ask, requests: tuple[ChunkRequest, ...], in_flight: int) -> Turn:
    return runner.run(_turn(ask, requests, in_flight))


async def _turn(ask: Ask, requests: tuple[ChunkRequest, ...], in_flight: int) -> Turn:
    unasked = iter(requests)

    async def client() -> None:
        for request in unasked:
            await ask(request)

    cpu, started = time.process_time(), time.perf_counter()
    await asyncio.gather(*(client() for _ in range(in_flight)))
    return Turn(len(requests), time.perf_counter() - started, time.process_time() - cpu)


def _figure(figure: tuple[str, str], turns: list[Turn], peers: list[Turn]) -> Figure:
    value = FIGURES[figure]
    ratios = tuple(value(a) / value(b) for a, b in zip(turns, peers, strict=True)) if peers else ()
    return Figure(*figure, tuple(map(value, turns)), ratios)


if __name__ == "__main__":
    main(_build, lambda: Warmth(SOURCES_DIGEST, 0, 0.0))
