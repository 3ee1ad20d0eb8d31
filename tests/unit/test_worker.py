"""Frames, the worker's loop, and the folder of compiled code; what needs several processes is in tests/fault."""

import io
import os
import random
import socket
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest

from chunkserver import memory, worker
from chunkserver.errors import BadKey, ChunkError, DeadlinePassed, WireError
from chunkserver.field import compiling
from chunkserver.grid import ChunkKey
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.memory import SLOT_BYTES, Slot, slot_memory
from chunkserver.mesher import MESHERS
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.wire import FORMATS

REQUEST = ChunkRequest(WorldRecipe(7, builtin("plane")), ChunkKey(0, 1, 2, 3))


def frames(*values: object) -> io.BytesIO:
    return io.BytesIO(b"".join(worker.pack(value, 1000) for value in values))


def test_frames_come_out_as_they_went_in():
    pipe = frames(REQUEST, "text", 5)
    assert [worker.receive(pipe, 1000) for _ in range(3)] == [REQUEST, "text", 5]
    assert worker.receive(pipe, 1000) is None


@pytest.mark.parametrize("length", [1, 3, 5, 11])
def test_a_torn_frame_is_an_error_and_not_an_end(length):
    pipe = io.BytesIO(frames("some text").getvalue()[:length])
    with pytest.raises(WireError, match="ends after"):
        worker.receive(pipe, 1000)


def test_a_frame_longer_than_the_limit_is_neither_made_nor_read():
    body = bytes(100)
    frame = worker.pack(body, 1000)
    length = len(frame) - worker.HEADER.size
    assert worker.receive(io.BytesIO(frame), length) == body
    with pytest.raises(WireError) as made:
        worker.pack(body, length - 1)
    with pytest.raises(WireError) as read:
        worker.receive(io.BytesIO(frame), length - 1)
    assert made.value.values == read.value.values == {"bytes": length, "bytes_max": length - 1}


@pytest.fixture
def slots():
    """The two ends of a slot, and the descriptor of its memory."""
    descriptor = slot_memory()
    ours, theirs = Slot(descriptor), Slot(descriptor)
    yield ours, theirs, descriptor
    for slot in (ours, theirs):
        slot.close()
    os.close(descriptor)


@pytest.fixture
def served(slots):
    """Serve the other end of a pipe in a thread; yield a function from a request to its answer."""
    ours_of_slot, theirs_of_slot, _ = slots

    @contextmanager
    def serving(build):
        ours, theirs = socket.socketpair()
        thread = threading.Thread(target=worker.serve, args=(theirs, theirs_of_slot, build))
        thread.start()
        with ours, ours.makefile("rb") as answers:
            assert worker.receive(answers, 1000) == os.getpid()

            def ask(request, seconds=60.0):
                ours.sendall(worker.pack((request, time.monotonic() + seconds, None), worker.FRAME_BYTES_MAX))
                answer = worker.receive(answers, worker.FRAME_BYTES_MAX)
                if not isinstance(answer, tuple):
                    return answer
                built = worker.Built(*answer)
                return built, ours_of_slot.take(built.length)

            yield ask
            ours.shutdown(socket.SHUT_RDWR)
            thread.join(10)
        assert not thread.is_alive(), "the end of the pipe ends the worker"

    return serving


def test_a_worker_answers_until_its_pipe_ends(served):
    with served(lambda request, _stage: Chunk("surface", repr(request).encode(), 7)) as ask:
        for _ in range(3):
            built, body = ask(REQUEST)
            assert (built.content, body, built.revision) == ("surface", repr(REQUEST).encode(), 7)


SIZES = (0, 1, SLOT_BYTES, SLOT_BYTES + 1, 20_000_000, 5, 3 << 20, 0, SLOT_BYTES)


def test_a_slot_grows_for_a_body_and_shrinks_when_it_is_taken(slots):
    ours, theirs, descriptor = slots
    for size in SIZES:
        body = random.Random(size).randbytes(size)
        theirs.put(body)
        assert os.fstat(descriptor).st_size == max(size, SLOT_BYTES)
        assert ours.take(size) == body
        assert os.fstat(descriptor).st_size == SLOT_BYTES


def test_a_body_beyond_the_limit_is_a_fault_and_the_next_is_right(served, monkeypatch):
    monkeypatch.setattr(memory, "BODY_BYTES_MAX", SLOT_BYTES + 10)
    with served(lambda request, _stage: Chunk("surface", bytes(SLOT_BYTES + request.key.x))) as ask:
        text = ask(replace(REQUEST, key=ChunkKey(0, 11, 0, 0)))
        assert text.startswith("Traceback")
        assert f"a body has {SLOT_BYTES + 11} bytes; the limit is {SLOT_BYTES + 10}" in text
        built, body = ask(replace(REQUEST, key=ChunkKey(0, 10, 0, 0)))
        assert len(body) == built.length == SLOT_BYTES + 10


def test_the_time_of_each_stage_is_told(served):
    times = {"field": 0.02, "mesh": 0.0, "encode": 0.01}

    def build(_request, stage):
        for name, seconds in times.items():
            stage(name)
            time.sleep(seconds)
        return Chunk("surface", b"body")

    with served(build) as ask:
        began = time.monotonic()
        built, _ = ask(REQUEST)
        assert list(built.seconds) == list(times)
        assert all(built.seconds[name] >= seconds for name, seconds in times.items())
        assert sum(built.seconds.values()) <= time.monotonic() - began


@pytest.mark.parametrize("late", range(3))
def test_a_build_is_given_up_before_the_next_stage_when_it_is_too_late(served, late):
    begun = []

    def build(_request, stage):
        for number, name in enumerate(("field", "mesh", "encode")):
            if number == late:
                time.sleep(0.5)
            stage(name)
            begun.append(name)
        return Chunk("surface", b"body")

    with served(build) as ask:
        error = ask(REQUEST, 0.5 if late else -0.001)
        assert type(error) is DeadlinePassed
        assert error.values == {"stage": ("field", "mesh", "encode")[late]}
        assert len(begun) == late
        assert ask(REQUEST)[1] == b"body", "the worker goes on"


def test_a_worker_tells_by_how_much_it_has_grown(served, monkeypatch):
    monkeypatch.setattr(worker, "JOBS_PER_MEASURE", 2)
    grown = []

    def build(request, _stage):
        grown.append(bytearray(os.urandom(request.key.x)))
        return Chunk("surface", b"")

    with served(build) as ask:
        told = [ask(replace(REQUEST, key=ChunkKey(0, size, 0, 0)))[0].grown_bytes for size in (0, 0, 1 << 24, 0)]
    assert told[0] == 0, "it is not measured at each job"
    assert told[2] == told[1] < 1 << 23
    assert told[3] - told[1] >= 1 << 23
    monkeypatch.undo()
    assert worker.JOBS_PER_MEASURE > 1


def raiser(error: BaseException):
    def build(_request, _stage):
        raise error

    return build


def test_an_error_of_ours_arrives_with_its_class_and_values(served):
    with served(raiser(BadKey("x is 9", x=9, limits=(-4, 4)))) as ask:
        error = ask(REQUEST)
    assert type(error) is BadKey
    assert (str(error), error.message, error.values) == ("x is 9", "x is 9", {"x": 9, "limits": (-4, 4)})


@pytest.mark.parametrize("error", [RuntimeError("a fault"), ChunkError("a fault", of=threading.Lock())])
def test_any_other_error_arrives_as_its_traceback(served, error):
    with served(raiser(error)) as ask:
        for _ in range(2):
            text = ask(REQUEST)
            assert text.startswith("Traceback")
            assert "test_worker.py" in text or "cannot pickle" in text


def test_a_long_traceback_loses_its_beginning(served):
    with served(raiser(RuntimeError("x" * (2 * worker.FRAME_BYTES_MAX) + " the end"))) as ask:
        text = ask(REQUEST)
    assert len(text) == worker.TRACEBACK_CHARACTERS_MAX
    assert text.endswith("the end\n")


def test_a_torn_request_ends_the_worker(slots):
    ours, theirs = socket.socketpair()
    ours.sendall(worker.pack(REQUEST, 1000)[:-1])
    ours.shutdown(socket.SHUT_WR)
    with ours, pytest.raises(WireError):
        worker.serve(theirs, slots[1], raiser(AssertionError("it was not whole")))


def test_warm_requests_reach_every_recipe_mesher_format_and_profile():
    requests = list(worker.warm_requests())
    assert {request.recipe.source for request in requests} >= {builtin(name) for name in BUILTINS}
    assert {(request.mesher, request.encoding.format, request.encoding.profile) for request in requests} >= {
        (mesher, row.name, profile) for mesher in MESHERS for row in FORMATS.values() for profile in row.profiles
    }


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache root in which warming builds nothing."""
    monkeypatch.setattr(worker, "cache_root", lambda: tmp_path)
    monkeypatch.setattr(worker, "CACHE_DIR", tmp_path / "kernels-now")
    monkeypatch.setattr(worker, "build_chunk", lambda _request, edited=None: edited)
    monkeypatch.setattr(worker, "_edit_once", lambda: None)
    monkeypatch.setattr(compiling, "compile_interpreter", lambda: None)
    monkeypatch.setattr(worker, "COMPILE_REST", (sys.executable, "-c", ""))
    return tmp_path


def test_warming_counts_what_it_compiled(cache, monkeypatch):
    built, edits = [], []

    def build(request, edited=None):
        built.append(request)
        edits.extend([] if edited is None else [edited])
        (cache / "kernels-now" / f"{len(built)}.nbi").touch()

    monkeypatch.setattr(worker, "build_chunk", build)
    warmth = worker.warm()
    assert warmth.compiled == len(built) == len(list(worker.warm_requests())) + len(edits)
    assert len(edits) == 1
    assert warmth.sources == SOURCES_DIGEST
    monkeypatch.setattr(worker, "build_chunk", lambda _request, edited=None: edited)
    assert worker.warm().compiled == 0


def test_warming_compiles_what_edits_run_whatever_was_compiled_before(cache, monkeypatch):
    """As by a command that builds chunks alone, or a first start that was broken off."""
    now = cache / "kernels-now"
    now.mkdir()
    (now / "chunks.nbi").touch()
    monkeypatch.setattr(worker, "_edit_once", (now / "edits.nbi").touch)
    assert worker.warm().compiled == 1
    assert worker.warm().compiled == 0


def test_warming_forgets_the_oldest_folders_and_nothing_else(cache):
    for age in range(worker.CACHE_FOLDERS_MAX + 3):
        folder = cache / ("kernels-now" if age == 10 else f"kernels-{age}")
        (folder / "module").mkdir(parents=True)
        os.utime(folder, (1e9 - age, 1e9 - age))
    (cache / "of-somebody-else").mkdir()
    worker.warm()
    kept = {path.name for path in cache.iterdir()} - {"warm.lock", "of-somebody-else"}
    assert kept == {"kernels-now", *(f"kernels-{age}" for age in range(worker.CACHE_FOLDERS_MAX - 1))}
    assert (cache / "of-somebody-else").is_dir()


def test_the_first_start_compiles_in_two_processes_and_needs_neither(cache, monkeypatch):
    """What fails beside is compiled by the requests; what is compiled already is not compiled beside."""
    (cache / "kernels-now").mkdir()
    beside = cache / "beside"
    command = f"open({str(beside)!r}, 'a').write('x'); raise SystemExit(1)"
    monkeypatch.setattr(worker, "COMPILE_REST", (sys.executable, "-c", command))
    monkeypatch.setattr(compiling, "compile_interpreter", (cache / "kernels-now" / "run.nbi").touch)
    assert worker.warm().compiled == 1
    assert worker.warm().compiled == 0
    assert beside.read_text() == "x"
