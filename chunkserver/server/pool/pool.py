"""All worker processes as one awaitable: `await pool.build(request)`.

    build -> waiting -> an idle worker -> Chunk
                ^            |
                +---- lost --+     once; a request that was on LOSSES_MAX lost workers is refused

A worker is lost when it ends, and when it hangs: then it is killed. The supervisor keeps the number of workers: it
forks one for each that is lost or has grown too large. When the fork server ends, or does not fork in time, it kills
all that is left of it and starts another; jobs wait meanwhile, until their deadline, and those that its workers had
have lost nothing. The workers may be seen to end before it is: so a loss counts once it has forked another in place of
the lost. Starts that fail are spaced out, up to RETRY_SECONDS_MAX apart.
"""

import asyncio
import logging
import os
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from chunkserver.edits import Bricks
from chunkserver.errors import ChunkError, DeadlinePassed, Overloaded, Unavailable, WorkerLost
from chunkserver.memory import NO_ARENA, arena_memory, mapped
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.server.pool.job import URGENCY_DEFAULT, Job, rank
from chunkserver.server.pool.tally import QUEUE, Tally
from chunkserver.server.pool.waiting import Waiting
from chunkserver.server.pool.workers import FORK_SERVER, ForkServer, Worker

RETRY_SECONDS: Final = 0.05
RETRY_SECONDS_MAX: Final = 5.0
LOSSES_MAX: Final = 2
TICK_SECONDS: Final = 0.05
"""How often deadlines are looked at. A timer for each job costs more than all the rest of it."""

_log: Final = logging.getLogger(__package__)


@dataclass(frozen=True, slots=True)
class Limits:
    """What bounds the waiting, and the workers.

    jobs_waiting: jobs without a worker; one more is refused.
    answer_seconds: from the request to its answer, waiting included.
    build_seconds: one build; a worker that takes longer is taken for hung. Its job is tried once more, so that twice
        this lies well within `answer_seconds`.
    worker_bytes: what a worker's own memory may have grown by before it is replaced.
    arena_bytes: for the bricks of edits. What is not written to takes no memory.
    """

    jobs_waiting: int = 256
    answer_seconds: float = 30.0
    build_seconds: float = 10.0
    worker_bytes: int = 1 << 28
    arena_bytes: int = 1 << 29


LIMITS_DEFAULT: Final = Limits()


class Pool:
    """Builds chunks in `workers` processes. Belongs to the event loop in which it is started.

    tally: what it has counted.
    arena: (n,) int32, memory that all workers read: where bricks have to lie.

    Raises OSError if there is no memory to share.
    """

    def __init__(
        self,
        workers: int,
        limits: Limits = LIMITS_DEFAULT,
        command: Sequence[str] = FORK_SERVER,
    ) -> None:
        self._arena = arena_memory(limits.arena_bytes)
        self._let_go = weakref.finalize(self, os.close, self._arena)
        self.arena = mapped(self._arena, writable=True)
        self.tally = Tally()
        self._count = workers
        self._limits = limits
        self._command = command
        self._workers: set[Worker] = set()
        self._idle: list[Worker] = []
        self._waiting = Waiting(limits.jobs_waiting)
        self._lost_jobs: list[Job] = []
        self._ready = asyncio.Event()
        self._changed = asyncio.Event()
        self._retry_seconds = RETRY_SECONDS
        self._closing = False
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def ready(self) -> bool:
        """Whether the kernels are warm and all workers were there; one that is being replaced does not count."""
        return self._ready.is_set()

    async def wait_ready(self) -> None:
        """Return when `ready`."""
        await self._ready.wait()

    async def start(self) -> None:
        """Begin to start the workers. Returns at once: `ready` tells when they are there."""
        self._tasks = [asyncio.create_task(self._supervise()), asyncio.create_task(self._watch())]

    @property
    def waiting(self) -> int:
        """How many jobs wait for a worker."""
        return len(self._waiting)

    @property
    def busy(self) -> int:
        """How many workers have a job."""
        return sum(worker.job is not None for worker in self._workers)

    def refuses(self, urgency: int, lod: int = 0) -> bool:
        """Whether `build` would raise `Overloaded` now for a request of this urgency, at distance 0. Cheap."""
        return self._waiting.refuses(rank(urgency, 0.0, lod))

    def build(
        self,
        request: ChunkRequest,
        begun: Callable[[], None] = lambda: None,
        *,
        urgency: int = URGENCY_DEFAULT,
        distance: float = 0.0,
        bricks: Bricks | None = None,
    ) -> asyncio.Future[Chunk]:
        """Return what `build_chunk` returns, made by a worker. Cancelled before it calls `begun`, it leaves the queue.

        A future, not a coroutine: a task for each chunk would cost more than what it does.

        begun: called when a worker gets the request, and once more if that worker is lost.
        urgency: from 0, first, to 7. distance: from the viewer, in chunk lengths; of equal urgency the near ones are
            first, of these the coarse ones.
        bricks: of the world at the request's revision, if an edit has reached the chunk. They lie in `arena`.

        It raises what `build_chunk` raises; `Overloaded`, `DeadlinePassed`, `WorkerLost`, or `Unavailable` while the
        pool closes; plain `ChunkError` for a fault of ours, which is in the log.
        """
        job = Job.of(request, self._limits.answer_seconds, rank(urgency, distance, request.key.lod), begun, bricks)
        if self._closing:
            job.settle(_stopping())
            return job.answer
        refused = self._waiting.push(job)
        if refused is not None:
            self.tally.refused += 1
            waiting = len(self._waiting)
            refused.settle(Overloaded(f"{waiting} requests are waiting for a worker", waiting=waiting))
        if self._idle:
            self._give_out()
        job.answer.add_done_callback(partial(self._answered, job))
        return job.answer

    async def close(self) -> None:
        """End all workers. Jobs that are not done raise `Unavailable`; builds that should finish are awaited before."""
        self._closing = True
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
        for job in self._waiting:
            job.settle(_stopping())
        self._let_go()
        self.arena = NO_ARENA

    def _answered(self, job: Job, answer: asyncio.Future[Chunk]) -> None:
        if answer.cancelled():
            self._waiting.leave(job)

    def _give_out(self) -> None:
        now = time.monotonic()
        while self._idle and (job := self._waiting.take(now)) is not None:
            try:
                self._idle[-1].give(job, now)
            except ChunkError as error:
                job.settle(error)
                continue
            self._idle.pop()
            self.tally.seconds[QUEUE].observe(now - job.asked)
            job.begun()

    def _worker_idle(self, worker: Worker) -> None:
        self._idle.append(worker)
        if self._is_worn(worker):
            self._changed.set()
        if len(self._workers) > self._count:
            self._retire()
        self._give_out()

    def _is_worn(self, worker: Worker) -> bool:
        return worker.grown_bytes > self._limits.worker_bytes

    def _fresh(self) -> int:
        return sum(not self._is_worn(worker) for worker in self._workers)

    def _retire(self) -> None:
        """End idle workers that have grown too large, as far as others are there in their place."""
        surplus = sum(worker.pid != 0 for worker in self._workers) - self._count
        for worker in [worker for worker in self._idle if self._is_worn(worker)][: max(0, surplus)]:
            _log.info("worker %d has grown by %d bytes: it is replaced", worker.pid, worker.grown_bytes)
            self.tally.recycled += 1
            self._idle.remove(worker)
            self._workers.discard(worker)
            worker.kill()

    def _worker_lost(self, worker: Worker) -> None:
        if worker not in self._workers:  # it was ended on purpose
            return
        self._workers.discard(worker)
        if worker in self._idle:
            self._idle.remove(worker)
        job = worker.take_back()
        if worker.pid != 0:  # one that never came to be is told of by who asked for it
            self.tally.lost += 1
            _log.warning("worker %d is lost%s", worker.pid, f" while it built {job.request.key}" if job else "")
        if job is not None and self._fresh() < self._count:
            self._lost_jobs.append(job)
        elif job is not None:  # nothing is forked in place of this one
            self._retry(job)
        self._changed.set()

    def _retry(self, job: Job) -> None:
        job.losses += 1
        if job.answer.done():
            return
        if job.losses >= LOSSES_MAX:
            message = f"{job.losses} workers ended, or took too long, while they built this chunk"
            job.settle(WorkerLost(message, key=list(job.request.key), losses=job.losses))
        else:
            self.tally.retried += 1
            self._waiting.put_back(job)
            self._give_out()

    async def _watch(self) -> None:
        """Keep all deadlines."""
        while True:
            await asyncio.sleep(TICK_SECONDS)
            now = time.monotonic()
            self._kill_hung(now)
            jobs = *self._waiting, *self._lost_jobs, *(worker.job for worker in self._workers if worker.job is not None)
            for job in [job for job in jobs if now > job.deadline]:
                self._expire(job)

    def _kill_hung(self, now: float) -> None:
        seconds = self._limits.build_seconds
        for worker in [worker for worker in self._workers if worker.busy_seconds(now) > seconds]:
            self.tally.hung += 1
            _log.error("worker %d takes over %g s: it is killed", worker.pid, seconds)
            worker.kill()

    def _expire(self, job: Job) -> None:
        """Tell the caller that it is too late. A worker that has the job gives it up by itself."""
        self._waiting.leave(job)
        seconds = self._limits.answer_seconds
        self.tally.expired += job.settle(DeadlinePassed(f"no answer within {seconds:g} s", answer_seconds=seconds))

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

    def _retry_lost(self, count: int) -> None:
        """Try the first of the lost jobs again: the fork server has outlived their workers."""
        lost, self._lost_jobs = self._lost_jobs[:count], self._lost_jobs[count:]
        for job in lost:
            self._retry(job)

    def _kill_workers(self) -> None:
        """Their jobs wait again, now and not when the pipes are seen to end: this loss is no fault of theirs."""
        workers, self._workers = self._workers, set()
        lost, self._lost_jobs = self._lost_jobs, []
        self._idle.clear()
        for job in (*lost, *(worker.take_back() for worker in workers)):
            if job is not None and not job.answer.done():
                self._waiting.put_back(job)
        for worker in workers:
            worker.kill()

    async def _keep_workers(self, fork_server: ForkServer) -> None:
        while fork_server.alive:
            if self._fresh() < self._count:
                await self._start_worker(fork_server)
            else:
                self._retry_lost(len(self._lost_jobs))  # whatever was to be forked in their place
                self._ready.set()
                self._changed.clear()
                await self._changed.wait()
        raise ConnectionError("it has ended")

    async def _start_worker(self, fork_server: ForkServer) -> None:
        worker = Worker(self.tally, self._worker_idle, self._worker_lost)
        lost = len(self._lost_jobs)
        self._workers.add(worker)
        try:
            await fork_server.fork(worker, self._arena)
        except ConnectionError as error:
            self._workers.discard(worker)
            _log.warning("no worker was started: %s", error)
            await self._pause()
        else:
            self._retry_seconds = RETRY_SECONDS
            _log.info("worker %d has started", worker.pid)
            self._retry_lost(lost)

    async def _pause(self) -> None:
        """Wait a little; twice as long as the last time, unless a worker has started since."""
        seconds, self._retry_seconds = self._retry_seconds, min(2 * self._retry_seconds, RETRY_SECONDS_MAX)
        await asyncio.sleep(seconds)


def _stopping() -> Unavailable:
    return Unavailable("the server is stopping")
