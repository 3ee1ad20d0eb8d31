"""The real server, whose workers are killed all the while: each answer is right, to the byte."""

import hashlib
import itertools
import os
import random
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import httpx2

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.fault.pools import PATIENCE_SECONDS, children
from tests.scale import count
from tests.serving import Server, serving, until

CONNECTIONS = 8
KILLS = count(2_000)
WORLDS = {name: WorldRecipe(42, builtin(name)) for name in ("terrain", "caves", "planet", "hills")}
LOST = r"WARNING chunkserver\.server\.pool: (worker \d+ is lost|no worker was started)"
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


def kill_a_worker(server: Server) -> None:
    (fork_server,) = children(server.child.pid)
    with suppress(ProcessLookupError):
        os.kill(random.choice(until(lambda: children(fork_server), PATIENCE_SECONDS)), signal.SIGKILL)


def test_every_answer_is_right_to_the_byte(tmp_path):
    with serving(tmp_path / "log", "--workers", "2", expected=LOST) as server, ThreadPoolExecutor(CONNECTIONS) as pool:
        load = Load(server)
        clients = [pool.submit(load.run, connection) for connection in range(CONNECTIONS)]
        try:
            for _ in range(KILLS):
                load.wait_for_all()
                kill_a_worker(server)
        finally:
            load.over = True
        for client in clients:
            client.result()
    answers = {question: answer for found in load.answers for question, answer in found.items()}
    assert {status for status, _ in answers.values()} == {200, 204}
    assert answers == {question: right(*question) for question in answers}
    assert " is lost while it built" in (tmp_path / "log").read_text()
