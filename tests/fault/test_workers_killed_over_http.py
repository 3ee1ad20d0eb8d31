"""The real server, whose workers are killed or stopped all the while: each answer is right, to the byte, and nothing is
left of the lost."""

import hashlib
import itertools
import os
import random
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import httpx2
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.fault.pools import PATIENCE_SECONDS, children, open_files, slot_bytes
from tests.scale import TORTURE, count
from tests.serving import Server, serving, until

CONNECTIONS = 8
KILLS = count(2_000)
WORLDS = {name: WorldRecipe(42, builtin(name)) for name in ("terrain", "caves", "planet", "hills")}
LOST = r"(WARNING|ERROR) chunkserver\.server\.pool: (worker \d+ (is lost|takes over)|no worker was started)"
BUSY = " is lost while it built"
IDLE_MAX = 20
"""Workers that were lost in a row while they did nothing just then."""
SECONDS = 60 if TORTURE else 3
STOP_SECONDS = 5.0 if TORTURE else 1.0
"""Until a worker that is stopped is taken for hung."""
CACHE_BYTES = 1 << 20
GROWTH_BYTES_MAX = 32 << 20
"""Of the server, while it makes chunks of far more than that."""
Asked = tuple[str, ChunkKey, str]
Answer = tuple[int, str]


def asked(connection: int) -> Iterator[Asked]:
    """Yield what one connection asks for: no chunk twice, so that each is built."""
    for x in itertools.count():
        for number, name in enumerate(WORLDS):
            yield name, ChunkKey(0, x, x % 2, connection), ("mesh", "glb")[(number + x // 2) % 2]


def right(name: str, key: ChunkKey, suffix: str) -> Answer:
    """Return the status of the answer and the digest of its body."""
    chunk = build_chunk(ChunkRequest(WORLDS[name], key, encoding=Encoding(suffix)))
    empty = chunk.content != "surface" and suffix == "mesh"
    return 204 if empty else 200, hashlib.sha256(b"" if empty else chunk.body).hexdigest()


class Load:
    """Clients that ask one thing after the other until `over`; `answers` has a dictionary for each of them."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.over = False
        self.answers: list[dict[Asked, Answer]] = [{} for _ in range(CONNECTIONS)]

    def run(self, connection: int) -> None:
        with httpx2.Client(base_url=self.server.url, timeout=PATIENCE_SECONDS) as client:
            for name, key, suffix in asked(connection):
                path = f"/v1/seeds/42/chunks/{key.lod}/{key.x}/{key.y}/{key.z}.{suffix}?recipe={name}"
                found = client.get(path)
                self.answers[connection][name, key, suffix] = (
                    found.status_code,
                    hashlib.sha256(found.content).hexdigest(),
                )
                if self.over:
                    return

    def wait_for_all(self) -> None:
        """Return when what is asked now has been answered: a request that loses two workers is a test of its own."""
        before = [len(answers) for answers in self.answers]
        until(
            lambda: all(len(now) > old for now, old in zip(self.answers, before, strict=True)),
            PATIENCE_SECONDS,
            "every connection has got an answer",
        )


def workers_of(server: Server) -> list[int]:
    (fork_server,) = children(server.child.pid)
    return children(fork_server)


def send_to_a_worker(server: Server, number: int = signal.SIGKILL) -> None:
    with suppress(ProcessLookupError):
        os.kill(random.choice(until(lambda: workers_of(server), PATIENCE_SECONDS)), number)


@contextmanager
def loaded(log: Path, *options: str) -> Iterator[Load]:
    """A server of two workers, and its clients; at the end all that they were answered is right."""
    served = serving(log, "--workers", "2", "--cache-bytes", str(CACHE_BYTES), *options, expected=LOST)
    with served as server, ThreadPoolExecutor(CONNECTIONS) as threads:
        load = Load(server)
        clients = [threads.submit(load.run, connection) for connection in range(CONNECTIONS)]
        try:
            yield load
        finally:
            load.over = True
        for client in clients:
            client.result()
    answers = {question: answer for found in load.answers for question, answer in found.items()}
    assert {status for status, _ in answers.values()} == {200, 204}
    assert answers == {question: right(*question) for question in answers}
    assert BUSY in log.read_text()


def test_every_answer_is_right_to_the_byte(tmp_path):
    with loaded(tmp_path / "log") as load:
        for _ in range(KILLS):
            load.wait_for_all()
            send_to_a_worker(load.server)


def in_use(server: Server) -> tuple[tuple[int, int, int], int]:
    """Return the descriptors of the server and of its fork server, the bytes of slots; and the server's own memory."""
    until(lambda: len(workers_of(server)) == 2, PATIENCE_SECONDS)
    pid, (fork_server,) = server.child.pid, children(server.child.pid)
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    memory = sum(int(line.split()[1]) * 1024 for line in lines if line.startswith(("RssAnon", "RssShmem")))
    return (open_files(pid), open_files(fork_server), slot_bytes(pid)), memory


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_one_worker_each_second_and_nobody_notices(tmp_path, number):
    with loaded(tmp_path / "log", "--build-seconds", str(STOP_SECONDS)) as load:
        load.wait_for_all()
        left, memory = in_use(load.server)
        began = time.monotonic()
        for second in itertools.count(1):
            load.wait_for_all()
            send_to_a_worker(load.server, number)
            until(partial(passed, began + second), PATIENCE_SECONDS)
            if second >= SECONDS and BUSY in (tmp_path / "log").read_text():
                break
            assert second < SECONDS + IDLE_MAX, "no worker was lost while it built"
        until(
            lambda: in_use(load.server)[0] == left,
            PATIENCE_SECONDS,
            "all that was lost is replaced, nothing else is left",
        )
        load.wait_for_all()
        assert in_use(load.server)[1] - memory < GROWTH_BYTES_MAX


def passed(end: float) -> bool:
    return time.monotonic() >= end
