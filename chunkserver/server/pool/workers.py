"""The server's end of the pipes: one worker process, and the fork server that starts them.

One worker:

                     pid                request
    (fork) STARTING -----> IDLE -----------------> BUSY
               |           |  ^                    | |
               |           |  +------ answer ------+ |
        end of |    end of |               end of    |  too slow: killed,
          pipe |     pipe, |                 pipe    |  then the pipe ends
               |     grown: killed once              |
               |     replaced                        |
               v           v                         v
                                  LOST

A worker has at most one job, and a pipe and a slot of its own: what is lost with it is that job and nothing else.
Whether the caller still waits does not matter here: the answer is read all the same, so that the pipe is never out of
step.
"""

import asyncio
import enum
import logging
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final, cast

from chunkserver.errors import ChunkError, DeadlinePassed, Unavailable, WireError
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.memory import Slot, slot_memory
from chunkserver.pipeline import Chunk
from chunkserver.server.pool.job import Job
from chunkserver.server.pool.tally import BUILD, Tally
from chunkserver.worker import FRAME_BYTES_MAX, HEADER, Built, Warmth, frame_bytes

FORK_SERVER: Final = (sys.executable, "-P", "-m", "chunkserver.worker")
"""-P: what lies in the working directory is not imported."""
FORK_SERVER_ENVIRONMENT: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""There is a worker for each core; and a process that has threads must not fork."""
WARM_SECONDS_MAX: Final = 300.0
START_SECONDS_MAX: Final = 10.0
"""From asking for a fork to the worker's first word."""

_log: Final = logging.getLogger(__package__)


class _Pipe(asyncio.Protocol):
    """One end of a socket on which the other end has at most one frame under way. Anything else ends it."""

    def __init__(self) -> None:
        self._received = b""
        self._transport: asyncio.Transport | None = None

    def arrived(self, value: Any) -> None:
        raise NotImplementedError

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        self._received = received = self._received + data if self._received else data
        if len(received) < HEADER.size:
            return
        try:
            missing = HEADER.size + frame_bytes(received, FRAME_BYTES_MAX) - len(received)
            if missing < 0:
                raise WireError(f"{-missing} bytes follow a frame", bytes=-missing)
            if missing == 0:
                self._received = b""
                self.arrived(pickle.loads(received[HEADER.size :]))
        except WireError as error:
            _log.error("a pipe is out of step: %s", error)
            self.abort()

    def abort(self) -> None:
        """Close at once; `connection_lost` follows when the loop comes round."""
        if self._transport is not None:
            self._transport.abort()


class _State(enum.Enum):
    STARTING = enum.auto()
    IDLE = enum.auto()
    BUSY = enum.auto()
    LOST = enum.auto()


class Worker(_Pipe):
    """One worker process, as drawn above. `idle` and `lost` are told when it gets there.

    slot: there once it is forked. grown_bytes: its own memory, as it last told.
    """

    def __init__(self, tally: Tally, idle: Callable[["Worker"], None], lost: Callable[["Worker"], None]) -> None:
        super().__init__()
        self.pid = 0
        self.job: Job | None = None
        self.slot: Slot
        self.pipe: socket.socket
        self.started: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.grown_bytes = 0
        self._state = _State.STARTING
        self._tally = tally
        self._idle = idle
        self._lost = lost
        self._given = 0.0

    def give(self, job: Job, now: float) -> None:
        """Send `job` to this idle worker. Raises what `Job.frame` does, and stays idle."""
        self._send(job.frame())
        self._state, self.job, self._given = _State.BUSY, job, now

    def _send(self, frame: bytes) -> None:
        """Send at once what goes: the transport would wait until the loop comes round, and the worker with it."""
        assert self._transport is not None
        try:
            sent = self.pipe.send(frame)
        except OSError:  # it is full, or at its end, which the transport sees too
            sent = 0
        if sent < len(frame):
            self._transport.write(frame[sent:])

    def busy_seconds(self, now: float) -> float:
        """Return for how long it has had its job; 0 if it has none."""
        return now - self._given if self.job is not None else 0.0

    def take_back(self) -> Job | None:
        """Return the job that it has not answered, if any: it is not its own any more, and not lost with it."""
        job, self.job = self.job, None
        return job

    def kill(self) -> None:
        """End it, whatever it does."""
        if self.pid != 0 and self._state is not _State.LOST:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
        self.abort()

    def arrived(self, value: Any) -> None:
        """Take its first word, which is its pid, or an answer. Raises `WireError` for a word that nobody asked for."""
        if self._state is _State.STARTING:
            self.pid = value
            if not self.started.done():
                self.started.set_result(None)
            self._be_idle()
        elif self.job is None:
            raise WireError("a worker answers what nobody has asked", pid=self.pid)
        elif isinstance(value, tuple):
            self._built(self.job, Built(*value))
        else:
            self._failed(self.job, value)

    def _be_idle(self) -> None:
        self._state, self.job = _State.IDLE, None
        self._idle(self)

    def _built(self, job: Job, built: Built) -> None:
        """Take the chunk, get the worker to its next job, and only then do all that it need not wait for."""
        seconds = self._tally.seconds
        seconds[BUILD].observe(time.monotonic() - self._given)
        chunk = Chunk(built.content, self.slot.take(built.length), built.revision)
        self.grown_bytes = built.grown_bytes
        self._be_idle()
        self._tally.done += 1
        job.settle(chunk)
        for stage, value in built.seconds.items():
            seconds[stage].observe(value)

    def _failed(self, job: Job, answer: ChunkError | str) -> None:
        self._tally.failed += 1
        settled = job.settle(job.fault(answer) if isinstance(answer, str) else answer)
        self._tally.expired += settled and isinstance(answer, DeadlinePassed)
        self._be_idle()

    def connection_lost(self, _error: Exception | None) -> None:
        """Be lost."""
        self._state = _State.LOST
        self.slot.close()
        if not self.started.done():
            self.started.set_exception(ConnectionError("a worker ended before its first word"))
        self._lost(self)


class ForkServer(_Pipe):
    """The server's one child: warms, then forks a worker on request. It leads the group of all workers."""

    def __init__(self, command: Sequence[str], ended: Callable[[], None]) -> None:
        super().__init__()
        self.alive = True
        self._ended = ended
        self._warmth: asyncio.Future[Warmth] = asyncio.get_running_loop().create_future()
        self._control, theirs = socket.socketpair()
        with theirs:
            self._child = subprocess.Popen(
                [*command, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **FORK_SERVER_ENVIRONMENT},
                start_new_session=True,  # Ctrl-C in a terminal reaches the server alone, which then ends us
            )

    async def connect(self) -> Warmth:
        """Return when it is warm. Raises OSError if it ends or takes too long, `Unavailable` if its sources differ."""
        await asyncio.get_running_loop().create_connection(lambda: self, sock=self._control)
        async with asyncio.timeout(WARM_SECONDS_MAX):
            warmth = await self._warmth
        if warmth.sources != SOURCES_DIGEST:
            message = "the sources on disk are no longer those that this server runs; restart it"
            raise Unavailable(message, sources=SOURCES_DIGEST, on_disk=warmth.sources)
        return warmth

    async def fork(self, worker: Worker, arena: int) -> None:
        """Start `worker`. Raises OSError if it says nothing in time, ConnectionError if it ends instead.

        arena: descriptor of the memory that bricks lie in.
        """
        memory = slot_memory()
        try:
            worker.slot = Slot(memory)
            ours, theirs = socket.socketpair()
            worker.pipe = ours
            with theirs:
                self._ask_for_fork(ours, theirs.fileno(), memory, arena)
        finally:
            os.close(memory)
        await asyncio.get_running_loop().create_connection(lambda: worker, sock=ours)
        async with asyncio.timeout(START_SECONDS_MAX):
            await worker.started

    def _ask_for_fork(self, ours: socket.socket, *descriptors: int) -> None:
        try:
            socket.send_fds(self._control, [b"f"], descriptors)
        except OSError:
            ours.close()
            raise

    async def end(self) -> None:
        """Kill it with all its workers, and wait until it has ended."""
        with suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)
        self.abort()
        await asyncio.to_thread(self._child.wait)

    def arrived(self, value: Any) -> None:
        """Take its only word."""
        if not self._warmth.done():
            self._warmth.set_result(Warmth(*value))

    def connection_lost(self, _error: Exception | None) -> None:
        """Note that it has ended."""
        self.alive = False
        if not self._warmth.done():
            self._warmth.set_exception(ConnectionError("the fork server ended before it was warm"))
        self._ended()
