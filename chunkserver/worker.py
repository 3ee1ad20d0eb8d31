"""Worker processes, from the inside: the fork server, the workers that it forks, and what is said on their pipes.

    server ---- control ----> fork server     the server's one child: imports and warms everything, once
       |                           | fork
       +-------- pipe -------> worker         shares the fork server's memory; builds one chunk at a time
       +-------- slot -------> (memory)       holds the body that the worker has just built
       +-------- arena ------> (memory)       of all workers: the bricks that the deltas of edited chunks are in

    control   <- Warmth, once                 -> one byte with a socket, a slot, the arena: fork a worker for them
    pipe      <- pid, once; then an Answer for each request       -> ChunkRequest, its deadline, its Deltas or None

Each message is a frame: u32 little-endian length, then that many bytes of pickle. Both ends run the same code. A
deadline is a time of the monotonic clock, which all processes of a machine share.

Nothing outlives the server, however it ends: its end of the control socket closes with it, and the fork server, also
while it warms, then kills its process group, so that a worker that hangs ends too. SIGINT and SIGTERM are ignored here:
a stop that reaches the whole group lets the server finish what it has begun. Nothing here knows asyncio or loads the
web stack.
"""

import fcntl
import gc
import mmap
import os
import pickle
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, NoReturn, get_args

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits import Arena, Bricks, Deltas, Edit, History
from chunkserver.errors import ChunkError, DeadlinePassed, WireError
from chunkserver.field import compiling
from chunkserver.grid import CELLS_BUILT, MASK_MAX, ChunkKey, ChunkShape
from chunkserver.kernel import CACHE_DIR, SOURCES_DIGEST, cache_root
from chunkserver.memory import NO_ARENA, Slot, mapped
from chunkserver.mesh import Content, NormalKind
from chunkserver.mesher import MESHERS, extract
from chunkserver.pipeline import SEAM_OF_LEVELS, SKIRTS, Chunk, ChunkRequest, Edited, build_chunk
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.samples import Samples, coarse_box
from chunkserver.wire import FORMATS, Encoding

HEADER: Final = struct.Struct("<I")
FRAME_BYTES_MAX: Final = 1 << 18
TRACEBACK_CHARACTERS_MAX: Final = 1 << 14
"""Its end is kept. Fits a frame."""
JOBS_PER_MEASURE: Final = 64
"""How often a worker asks how much memory it has: that takes 30 us."""

assert 4 * TRACEBACK_CHARACTERS_MAX < FRAME_BYTES_MAX

COMPILE_REST: Final = (sys.executable, "-P", "-c", "from chunkserver.worker import compile_rest; compile_rest()")

ARENA_BYTES_TO_COMPILE: Final = 1 << 21
"""Of a world that is edited once."""
CACHE_FOLDERS_MAX: Final = 8
"""Folders of compiled code that `warm` keeps, the current one included."""

Build = Callable[..., Chunk]
"""Takes what `build_chunk` takes, in its order; deltas of edits only where there are some."""


def cores() -> int:
    """Return how many cores this process may run on: as many chunks as are built at once by default."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Built(NamedTuple):
    """What a worker says of a chunk that it has built: on the pipe a plain tuple, in half the time.

    length: of the body, which is in the slot.
    revision: of the last edit that is in it.
    seconds: by stage.
    grown_bytes: memory of the worker's own, beyond what it was forked with, as last measured.
    """

    content: Content
    length: int
    revision: int
    seconds: dict[str, float]
    grown_bytes: int


Answer = Built | ChunkError | str
"""What a worker says to a request: what it built, an error of ours, or the traceback of anything else (for the log)."""


class Warmth(NamedTuple):
    """What `warm` did.

    sources: `SOURCES_DIGEST` of the code that was warmed.
    compiled: how many functions had to be compiled; 0 if all of them were on disk.
    seconds: how long it took.
    """

    sources: str
    compiled: int
    seconds: float


def pack(value: object, bytes_max: int) -> bytes:
    """Return the frame of `value`. Raises `WireError` if it has more than `bytes_max` bytes."""
    pickled = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    _check_length(len(pickled), bytes_max)
    return HEADER.pack(len(pickled)) + pickled


def frame_bytes(frame: bytes, bytes_max: int) -> int:
    """Return how many bytes follow the header that `frame` begins with.

    Raises `WireError` if the header is torn or they are more than `bytes_max`.
    """
    if len(frame) < HEADER.size:
        raise WireError(f"a frame's header ends after {len(frame)} bytes", bytes=len(frame))
    length: int = HEADER.unpack_from(frame)[0]
    _check_length(length, bytes_max)
    return length


def _check_length(length: int, bytes_max: int) -> None:
    if length > bytes_max:
        raise WireError(f"a frame has {length} bytes; the limit is {bytes_max}", bytes=length, bytes_max=bytes_max)


def receive(pipe: BinaryIO, bytes_max: int) -> Any:
    """Return the next value from `pipe`, or None at its end. Raises `WireError` on a torn or oversized frame."""
    header = pipe.read(HEADER.size)
    if not header:
        return None
    length = frame_bytes(header, bytes_max)
    pickled = pipe.read(length)
    if len(pickled) < length:
        raise WireError(f"a frame of {length} bytes ends after {len(pickled)}", bytes=len(pickled))
    return pickle.loads(pickled)


class _Stages:
    """Times the stages of one build, and ends it before the next of them once its deadline has passed."""

    def __init__(self, deadline: float) -> None:
        self._deadline = deadline
        self._begun: list[tuple[str, float]] = []

    def __call__(self, stage: str) -> None:
        now = time.monotonic()
        if now > self._deadline:
            raise DeadlinePassed(f"the build was given up before its {stage} stage", stage=stage)
        self._begun.append((stage, now))

    def seconds(self) -> dict[str, float]:
        """Return how long each stage took; the last one has just ended."""
        times = [*self._begun, ("", time.monotonic())]
        return {stage: end - begin for (stage, begin), (_, end) in pairwise(times)}


def serve(pipe: socket.socket, slot: Slot, build: Build = build_chunk, arena: NDArray[np.int32] = NO_ARENA) -> None:
    """Be a worker: say our pid, then answer each request until the pipe ends. Raises what `receive` raises.

    arena: where the bricks lie that deltas read: as `Edited` has it.
    """
    with pipe, pipe.makefile("rb") as requests:
        at_first = _own_bytes()
        grown = jobs = 0
        pipe.sendall(pack(os.getpid(), FRAME_BYTES_MAX))
        while (asked := receive(requests, FRAME_BYTES_MAX)) is not None:
            jobs += 1
            if jobs % JOBS_PER_MEASURE == 0:
                grown = _own_bytes() - at_first
            request, deadline, deltas = asked
            stages, edited = _Stages(deadline), () if deltas is None else (Edited(arena, deltas),)
            pipe.sendall(_answer(partial(build, request, stages, *edited), stages, slot, grown))


def _own_bytes() -> int:
    """Return how much memory of this process is in RAM and stands for no file: see proc(5), statm."""
    _, resident, of_files, *_ = Path("/proc/self/statm").read_bytes().split()
    return (int(resident) - int(of_files)) * mmap.PAGESIZE


def _answer(build: Callable[[], Chunk], stages: _Stages, slot: Slot, grown_bytes: int) -> bytes:
    try:
        answer = _attempt(build)
        if isinstance(answer, Chunk):
            slot.put(answer.body)
            built = Built(answer.content, len(answer.body), answer.revision, stages.seconds(), grown_bytes)
            return pack(tuple(built), FRAME_BYTES_MAX)
        return pack(answer, FRAME_BYTES_MAX)
    except Exception:  # noqa: BLE001 - whatever it was, it is this request's alone: the worker lives on
        return pack(traceback.format_exc()[-TRACEBACK_CHARACTERS_MAX:], FRAME_BYTES_MAX)


def _attempt(build: Callable[[], Chunk]) -> Chunk | ChunkError:
    try:
        return build()
    except ChunkError as error:
        return error


def warm() -> Warmth:
    """Compile, or load from disk, every kernel of chunks and edits; then forget the oldest folders of compiled code.

    Edits too, whatever was compiled before: else who digs first would wait for it, longer than an answer may take.

    Safe in many processes at once: one compiles, the others wait and load. Raises OSError if the cache folder cannot
    be written.
    """
    started = time.perf_counter()
    with _locked_cache():
        before = _compiled()
        if before == 0:
            _compile_in_two()
        for request in warm_requests():
            build_chunk(request)
        _build_edited()
        _edit_once()
        compiled = _compiled() - before
        _forget_old_folders()
    return Warmth(SOURCES_DIGEST, compiled, time.perf_counter() - started)


def _compile_in_two() -> None:
    """Compile what takes longest here and the rest in a process beside: on two cores all is ready a third sooner.

    Skirts come last here: by then the mesher that they are drawn for is on disk. If the process beside fails or is
    late, this one compiles the rest too: then both write the same code into the same files, each of which is put in
    place at once.
    """
    with subprocess.Popen(COMPILE_REST) as beside:
        try:
            compiling.compile_interpreter()
            _extract_ball(skirts=True)
        finally:
            beside.wait()


def compile_rest() -> None:
    """Compile, beside the field's interpreter, the rest: every mesher, and what else the field says."""
    _extract_ball()
    _extract_ball(MASK_MAX)
    _edit_once()
    compiling.compile_beside()


def _extract_ball(mask: int = 0, skirts: bool = False) -> None:
    """Extract an eighth of a ball, which meets three faces, with every mesher and kind of normals."""
    shape = ChunkShape(min(CELLS_BUILT))
    along = np.arange(shape.samples, dtype=np.float32) - np.float32(shape.apron)
    squares = along[:, None, None] ** 2 + along[:, None] ** 2 + along**2
    coarse = np.zeros(coarse_box(shape.cells, mask).shape, np.float32) if mask else None
    ball = Samples(shape, np.sqrt(squares) - np.float32(shape.cells / 2), mask, coarse)
    for mesher in MESHERS:
        for normals in get_args(NormalKind):
            extract(ball, mesher, normals, skirts)


def warm_requests() -> Iterator[ChunkRequest]:
    """Yield small requests that between them run every kernel: each recipe; a surface in each mesher and encoding."""
    key, cells = ChunkKey(0, 0, 0, 0), min(CELLS_BUILT)
    for name in BUILTINS:
        yield ChunkRequest(WorldRecipe(0, builtin(name)), key, cells)
    ball = WorldRecipe(0, builtin("sphere", radius=cells / 2))
    for mesher in MESHERS:
        for row in FORMATS.values():
            for profile in row.profiles:
                encoding = Encoding(row.name, profile)
                for coarser, seam in ((0, SKIRTS), (1, SEAM_OF_LEVELS)):
                    yield ChunkRequest(ball, key, cells, 1.0, mesher, coarser, seam, encoding=encoding)


def _build_edited() -> None:
    """Build a chunk with deltas, all of them 0."""
    request = ChunkRequest(WorldRecipe(0, builtin("plane")), ChunkKey(0, 0, 0, 0), min(CELLS_BUILT))
    bricks = Bricks(1)
    deltas = Deltas.of(bricks, request.key, ChunkShape(request.cells))
    build_chunk(request, edited=Edited(bricks.arena.deltas, deltas._replace(own=deltas.own._replace(low=-1))))


@cache
def warm_edits() -> None:
    """Load from disk, or compile, what edits run; when nobody else compiles. Raises OSError as `warm` does."""
    with _locked_cache():
        _edit_once()


def _edit_once() -> None:
    """Edit a world with one of each kind of stroke, where all is air."""
    bricks = Bricks(2, Arena(np.zeros(ARENA_BYTES_TO_COMPILE // 4, np.int32)))
    shape = {"shape": "sphere", "center": [0, 0, 0], "radius": 1}
    kinds: list[dict[str, Any]] = [{"op": "carve"}, {"op": "fill"}, {"op": "add", "strength": 1}]
    edit = Edit.of([shape | kind for kind in kinds])
    History(bricks, lambda low, _: (np.ones(low.shape[1]), np.ones(low.shape[1])), min(CELLS_BUILT)).take(edit)
    bricks.apply([edit], 1, lambda box: np.ones(box.shape, np.float32))


def _compiled() -> int:
    return sum(1 for _ in CACHE_DIR.rglob("*.nbi"))


@contextmanager
def _locked_cache() -> Iterator[None]:
    """Hold the cache alone: Numba's index of a cache is corrupted when two processes write it at once."""
    CACHE_DIR.mkdir(parents=True, exist_ok=True)
    with (cache_root() / "warm.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # given back by the kernel, however we end
        yield


def _forget_old_folders() -> None:
    os.utime(CACHE_DIR)
    others = [folder for folder in cache_root().glob("kernels-*") if folder != CACHE_DIR]
    others.sort(key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in others[CACHE_FOLDERS_MAX - 1 :]:
        shutil.rmtree(folder, ignore_errors=True)


def main(build: Build = build_chunk, warm_up: Callable[[], Warmth] = warm) -> None:
    """Be the fork server on the control socket whose descriptor is `sys.argv[1]`, until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as control, suppress(ConnectionError):
        with _ending_with(control):
            warmth = warm_up()
        control.sendall(pack(tuple(warmth), FRAME_BYTES_MAX))
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel reaps: no worker is ever left as a zombie
        gc.collect()
        gc.freeze()  # a worker's collections leave the shared pages alone
        while descriptors := socket.recv_fds(control, 1, 3)[1]:
            pipe, *memory = descriptors
            _fork(control, socket.socket(fileno=pipe), memory, build)
    _end()


def _end() -> NoReturn:
    with suppress(ProcessLookupError):  # when run by hand we lead no group
        os.killpg(os.getpid(), signal.SIGKILL)
    os._exit(0)


@contextmanager
def _ending_with(control: socket.socket) -> Iterator[None]:
    """Within this, end at once when the server does: warming takes long, and holds a lock that another may wait for."""
    ours, theirs = socket.socketpair()
    watch = threading.Thread(target=_watch, args=(control, theirs), daemon=True)
    with theirs:
        with ours:
            watch.start()
            yield
        watch.join()  # a process that has threads must not fork


def _watch(control: socket.socket, over: socket.socket) -> None:
    """Wait for what comes first. The server says nothing before we are warm: what can be read is its end."""
    if control in select.select([control, over], [], [])[0]:
        _end()


def _fork(control: socket.socket, pipe: socket.socket, memory: Sequence[int], build: Build) -> None:
    """Fork a worker. memory: descriptors of its slot and of the arena."""
    with pipe:
        if os.fork() != 0:
            _close(memory)
            return
        try:
            control.close()  # the only descriptor of the fork server's that we hold: with it, its end would be hidden
            slot, arena = Slot(memory[0]), Arena(mapped(memory[1], writable=False)).deltas
            _close(memory)
            with suppress(ConnectionError):
                serve(pipe, slot, build, arena)
        except BaseException:  # noqa: BLE001 - nothing may unwind into the fork server's frames
            traceback.print_exc()
        finally:
            os._exit(0)


def _close(descriptors: Sequence[int]) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


if __name__ == "__main__":
    main()
