"""The server is killed at every sync, and at random, while clients send edits, and send again what was not answered.

Nothing is lost, nothing is written twice, and each client's edits are in its order.
"""

import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from chunkserver.store import EditLog, Store
from chunkserver.store.log import Edit
from tests.conftest import SEED
from tests.fault.log_program import WORLD, Tally
from tests.fault.log_program import tallies as tallies_of
from tests.scale import count

CLIENTS = 8
IN_FLIGHT_MAX = 4
KILLS = max(80, count(3000))
MOMENTS = 40
RANDOM_SECONDS_MAX = 0.05
SECONDS_MAX = 60.0 + KILLS / 10
BODY_BYTES_MAX = 3000


class Server:
    """The program that is killed, one life after the other."""

    def __init__(self, program: subprocess.Popen[str], address: str) -> None:
        self.program, self.address, self.over = program, address, threading.Event()

    def begin(self, moment: int) -> int:
        """Have a life that ends at a sync, or never if it is 0. Return its process."""
        assert self.program.stdin
        print(moment, file=self.program.stdin, flush=True)
        return int(self.said())

    def said(self) -> str:
        assert self.program.stdout
        line = self.program.stdout.readline()
        assert line, "the program has ended"
        return line.strip()

    def end(self, life: int) -> None:
        with suppress(ProcessLookupError):
            os.kill(life, signal.SIGKILL)
        assert self.said() == "ended"


@contextmanager
def serving(folder: Path) -> Iterator[Server]:
    """Run the program, for SECONDS_MAX at most."""
    address = str(folder / "socket")
    command = [sys.executable, "-m", "tests.fault.log_program", str(folder / "worlds"), address]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as program:
        watchdog = threading.Timer(SECONDS_MAX, os.killpg, (program.pid, signal.SIGKILL))
        watchdog.start()
        try:
            server = Server(program, address)
            assert server.said() == "listening"
            yield server
            print(file=program.stdin, flush=True)
            assert program.wait(SECONDS_MAX) == 0
        finally:
            watchdog.cancel()
            with suppress(ProcessLookupError):
                os.killpg(program.pid, signal.SIGKILL)


@dataclass
class Client:
    """Sends edits, a few at once, and again after each loss of its connection, until the server is over."""

    server: Server
    name: str
    chance: random.Random
    seq: int = 0
    unanswered: dict[int, bytes] = field(default_factory=dict)
    answers: dict[int, tuple[int, bytes]] = field(default_factory=dict)
    duplicates: int = 0

    def run(self) -> "Client":
        while not self.is_done() and self.server.program.poll() is None:
            with suppress(ConnectionError), socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(SECONDS_MAX)
                connection.connect(self.server.address)
                connection.sendall(f"{self.name}\n".encode() + b"".join(self.unanswered.values()))
                self.talk(connection)
        return self

    def is_done(self) -> bool:
        return self.server.over.is_set() and not self.unanswered

    def talk(self, connection: socket.socket) -> None:
        lines = connection.makefile("rb")
        while not self.is_done():
            while len(self.unanswered) < IN_FLIGHT_MAX and not self.server.over.is_set():
                connection.sendall(self.another())
            line = lines.readline()
            if not line.endswith(b"\n"):
                return
            seq, revision, duplicate = map(int, line.split())
            self.answers[seq] = (revision, self.unanswered.pop(seq))
            self.duplicates += duplicate

    def another(self) -> bytes:
        self.seq += self.chance.randint(1, 3)
        filling = "x" * self.chance.randint(0, BODY_BYTES_MAX)
        self.unanswered[self.seq] = f"{self.seq} {self.name}-{self.seq} {filling}\n".encode()
        return self.unanswered[self.seq]


def kill_again_and_again(server: Server, chance: random.Random) -> None:
    """Kill one life before its first sync, one at random, one after its first sync, one at random, and so on."""
    try:
        for number in range(KILLS):
            life = server.begin(0 if number % 2 else number // 2 % MOMENTS + 1)
            if number % 2:
                time.sleep(chance.uniform(0, RANDOM_SECONDS_MAX))  # the time itself is what is tried out
                server.end(life)
            else:
                assert server.said() == "ended"
    finally:
        server.over.set()


def edits_behind(log: EditLog, revision: int) -> list[Edit]:
    edits: list[Edit] = []
    while more := log.read(WORLD.epoch, revision + len(edits)):
        edits += more
    return edits


def test_clients_that_send_again_lose_nothing_and_double_nothing(tmp_path):
    """Each client's edits are in the foundation up to some number, and the others are in the log."""
    chance = random.Random(SEED)
    with ThreadPoolExecutor(CLIENTS) as threads, serving(tmp_path) as server:
        clients = [Client(server, f"c{number}", random.Random(chance.random())) for number in range(CLIENTS)]
        runs = [threads.submit(client.run) for client in clients]
        kill_again_and_again(server, chance)
        last = server.begin(0)
        for run in runs:
            run.result(SECONDS_MAX)
        server.end(last)
    with closing(Store(tmp_path / "worlds")) as store:
        founded, tallies = tallies_of(store.log)
        edits = edits_behind(store.log, founded)
        assert [edit.revision for edit in edits] == list(range(founded + 1, store.log.revision(WORLD.epoch) + 1))
    assert founded == sum(tally.edits for tally in tallies.values())
    for client in clients:
        sent = [(seq, line.partition(b" ")[2]) for seq, (_, line) in sorted(client.answers.items())]
        tally = Tally()
        while tally.edits < tallies[client.name].edits:
            tally = tally.and_one(*sent[tally.edits])
        assert tally == tallies[client.name], "none lost, none doubled, and in order, in the foundation"
        written = [(edit.seq, edit.strokes) for edit in edits if edit.client == client.name]
        assert written == sent[tally.edits :], "and behind it"
        revisions = [revision for _, (revision, _) in sorted(client.answers.items())]
        assert revisions == sorted(revisions)
    assert sum(client.duplicates for client in clients) > 0, "some were written, but not answered"
    assert founded > len(edits), "most of it was compacted"
