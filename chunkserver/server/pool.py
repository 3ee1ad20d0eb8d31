"""All worker processes as one awaitable: `await pool.build(request)`.

    build -> waiting -> an idle worker -> Chunk
                ^            |
                +---- lost --+     once; a request that was on LOSSES_MAX lost workers is refused

The supervisor keeps the number of workers: it forks one for each that is lost. When the fork server ends, or does not
fork in time, it kills all that is left of it and starts another; jobs wait meanwhile, as long as their callers do, and
those that it took from killed workers have lost nothing.
Starts that fail are spaced out, up to RETRY_SECONDS_MAX apart.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from chunkserver.errors import DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.server.workers import FORK_SERVER, ForkServer, Job, Worker

RETRY_SECONDS: Final = 0.05
RETRY_SECONDS_MAX: Final = 5.0
LOSSES_MAX: Final = 2

_log: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Limits:
    """What bounds the waiting.

    jobs_waiting: jobs without a worker; one more is refused.
    answer_seconds: from the request to its answer, waiting included.
    build_seconds: one build; a worker that takes longer is taken for hung.
    """

    jobs_waiting: int = 256
    answer_seconds: float = 30.0
    build_seconds: float = 10.0


LIMITS_DEFAULT: Final = Limits()


class Pool:
    """Builds chunks in `workers` processes. Belongs to the event loop in which it is started."""

    def __init__(
        self,
        workers: int,
        limits: Limits = LIMITS_DEFAULT,
        command: Sequence[str] = FORK_SERVER,
    ) -> None:
        self._count = workers
        self._limits = limits
        self._command = command
        self._workers: set[Worker] = set()
        self._idle: list[Worker] = []
        self._waiting: deque[Job] = deque()
        self._ready = asyncio.Event()
        self._changed = asyncio.Event()
        self._retry_seconds = RETRY_SECONDS
        self._closing = False
        self._supervisor: asyncio.Task[None] | None = None

    @property
    def ready(self) -> bool:
        """Whether the kernels are warm and all workers were there; one that is being replaced does not count."""
        return self._ready.is_set()

    async def wait_ready(self) -> None:
        """Return when `ready`."""
        await self._ready.wait()

    async def start(self) -> None:
        """Begin to start the workers. Returns at once: `ready` tells when they are there."""
        self._supervisor = asyncio.create_task(self._supervise())

    @property
    def waiting(self) -> int:
        """How many jobs wait for a worker."""
        return len(self._waiting)

    async def build(self, request: ChunkRequest, begun: Callable[[], None] = lambda: None) -> Chunk:
        """Return what `build_chunk` returns, made by a worker. Cancelled before it calls `begun`, it leaves the queue.

        begun: called when a worker gets the request, and once more if that worker is lost.

        Raises what `build_chunk` raises; `Overloaded`, `DeadlinePassed`, `WorkerLost`, or `Unavailable` while the pool
        closes; plain `ChunkError` for a fault of ours, which is in the log.
        """
        if self._closing:
            raise Unavailable("the server is stopping")
        if len(self._waiting) >= self._limits.jobs_waiting:
            raise Overloaded(f"{len(self._waiting)} requests are waiting for a worker", waiting=len(self._waiting))
        job = Job.of(request, begun)
        self._waiting.append(job)
        self._give_out()
        try:
            async with asyncio.timeout(self._limits.answer_seconds):
                return await job.answer
        except TimeoutError:
            seconds = self._limits.answer_seconds
            raise DeadlinePassed(f"no answer within {seconds:g} s", answer_seconds=seconds) from None
        finally:
            if job in self._waiting:
                self._waiting.remove(job)

    async def close(self) -> None:
        """End all workers. Jobs that are not done raise `Unavailable`; builds that should finish are awaited before."""
        self._closing = True
        if self._supervisor is not None:
            self._supervisor.cancel()
            await asyncio.wait([self._supervisor])
        for job in self._waiting:
            job.settle(Unavailable("the server is stopping"))

    def _give_out(self) -> None:
        while self._waiting and self._idle:
            job = self._waiting.popleft()
            job.begun()
            self._idle.pop().give(job, self._limits.build_seconds)

    def _worker_idle(self, worker: Worker) -> None:
        self._idle.append(worker)
        self._give_out()

    def _worker_lost(self, worker: Worker) -> None:
        self._workers.discard(worker)
        if worker in self._idle:
            self._idle.remove(worker)
        job = worker.job
        if worker.pid != 0 and not self._closing:  # one that never came to be is told of by who asked for it
            _log.warning("worker %d is lost%s", worker.pid, f" while it built {job.request.key}" if job else "")
        if job is not None and not job.answer.done():
            self._retry(job)
        self._changed.set()

    def _retry(self, job: Job) -> None:
        job.losses += 1
        if job.losses >= LOSSES_MAX:
            message = f"{job.losses} workers ended while they built this chunk"
            job.settle(WorkerLost(message, key=list(job.request.key), losses=job.losses))
        else:
            self._waiting.appendleft(job)
            self._give_out()

    async def _supervise(self) -> None:
        while True:
            try:
                await self._run_fork_server()
            except Exception as error:  # noqa: BLE001 - nobody else would ever start a worker again
                _log.error("the fork server is started again: %r", error)
            await self._pause()

    async def _run_fork_server(self) -> None:
        fork_server = ForkServer(self._command, self._changed.set)
        try:
            warmth = await fork_server.connect()
            _log.info("warm after %.2f s, %d functions compiled", warmth.seconds, warmth.compiled)
            await self._keep_workers(fork_server)
        finally:
            self._ready.clear()
            self._kill_workers()
            await fork_server.end()

    def _kill_workers(self) -> None:
        """Their jobs wait again, now and not when the pipes are seen to end: this loss is no fault of theirs."""
        self._idle.clear()
        for worker in list(self._workers):
            job = worker.take_back()
            if job is not None and not job.answer.done():
                self._waiting.appendleft(job)
            worker.kill()

    async def _keep_workers(self, fork_server: ForkServer) -> None:
        while fork_server.alive:
            if len(self._workers) < self._count:
                await self._start_worker(fork_server)
            else:
                self._ready.set()
                self._changed.clear()
                await self._changed.wait()
        raise ConnectionError("it has ended")

    async def _start_worker(self, fork_server: ForkServer) -> None:
        worker = Worker(self._worker_idle, self._worker_lost)
        self._workers.add(worker)
        try:
            await fork_server.fork(worker)
        except ConnectionError as error:
            self._workers.discard(worker)
            _log.warning("no worker was started: %s", error)
            await self._pause()
        else:
            self._retry_seconds = RETRY_SECONDS
            _log.info("worker %d has started", worker.pid)

    async def _pause(self) -> None:
        """Wait a little; twice as long as the last time, unless a worker has started since."""
        seconds, self._retry_seconds = self._retry_seconds, min(2 * self._retry_seconds, RETRY_SECONDS_MAX)
        await asyncio.sleep(seconds)
