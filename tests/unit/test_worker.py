"""Frames, the worker's loop, and the folder of compiled code; what needs several processes is in tests/fault."""

import io
import os
import socket
import sys
import threading
from contextlib import contextmanager

import pytest

from chunkserver import worker
from chunkserver.errors import BadKey, ChunkError, WireError
from chunkserver.grid import ChunkKey
from chunkserver.kernel import SOURCES_DIGEST
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


@contextmanager
def served(build):
    """Serve the other end of a pipe in a thread; yield a function from a request to its answer."""
    ours, theirs = socket.socketpair()
    thread = threading.Thread(target=worker.serve, args=(theirs, build))
    thread.start()
    with ours, ours.makefile("rb") as answers:
        assert worker.receive(answers, 1000) == os.getpid()

        def ask(request):
            ours.sendall(worker.pack(request, worker.REQUEST_BYTES_MAX))
            return worker.receive(answers, worker.ANSWER_BYTES_MAX)

        yield ask
        ours.shutdown(socket.SHUT_RDWR)
        thread.join(10)
    assert not thread.is_alive(), "the end of the pipe ends the worker"


def test_a_worker_answers_until_its_pipe_ends():
    with served(lambda request: Chunk("surface", repr(request).encode())) as ask:
        for _ in range(3):
            assert ask(REQUEST) == Chunk("surface", repr(REQUEST).encode())


def raiser(error: BaseException):
    def build(_request):
        raise error

    return build


def test_an_error_of_ours_arrives_with_its_class_and_values():
    with served(raiser(BadKey("x is 9", x=9, limits=(-4, 4)))) as ask:
        error = ask(REQUEST)
    assert type(error) is BadKey
    assert (str(error), error.message, error.values) == ("x is 9", "x is 9", {"x": 9, "limits": (-4, 4)})


@pytest.mark.parametrize("error", [RuntimeError("a fault"), ChunkError("a fault", of=threading.Lock())])
def test_any_other_error_arrives_as_its_traceback(error):
    with served(raiser(error)) as ask:
        for _ in range(2):
            text = ask(REQUEST)
            assert text.startswith("Traceback")
            assert "test_worker.py" in text or "cannot pickle" in text


def test_a_torn_request_ends_the_worker():
    ours, theirs = socket.socketpair()
    ours.sendall(worker.pack(REQUEST, 1000)[:-1])
    ours.shutdown(socket.SHUT_WR)
    with ours, pytest.raises(WireError):
        worker.serve(theirs, raiser(AssertionError("it was not whole")))


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
    monkeypatch.setattr(worker, "build_chunk", lambda _request: None)
    monkeypatch.setattr(worker, "compile_interpreter", lambda: None)
    monkeypatch.setattr(worker, "COMPILE_REST", (sys.executable, "-c", ""))
    return tmp_path


def test_warming_counts_what_it_compiled(cache, monkeypatch):
    built = []

    def build(request):
        built.append(request)
        (cache / "kernels-now" / f"{len(built)}.nbi").touch()

    monkeypatch.setattr(worker, "build_chunk", build)
    warmth = worker.warm()
    assert warmth.compiled == len(built) == len(list(worker.warm_requests()))
    assert warmth.sources == SOURCES_DIGEST
    monkeypatch.setattr(worker, "build_chunk", lambda _request: None)
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
    monkeypatch.setattr(worker, "compile_interpreter", (cache / "kernels-now" / "run.nbi").touch)
    assert worker.warm().compiled == 1
    assert worker.warm().compiled == 0
    assert beside.read_text() == "x"
