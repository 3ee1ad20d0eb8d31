"""A program that keeps a log of edits, for tests that kill it: `python -m tests.fault.log_program FOLDER SOCKET`.

It serves one line at a time to whoever connects, by the store that a server has:

    in    seq of the connection's client, and a body
    out   the seq, its revision, and 1 if it is a duplicate

Beside that it compacts its log as fast as it can, and before it serves anybody: it lays a foundation of all edits, in
which each client has a `Tally`, and sweeps what is not needed any more.

For each life it forks, so that a new one begins within milliseconds. A line of its input says when that kills itself:
at which of the moments before and after its syncs; 0 is never. It prints the life's process id, and when that has
ended. An empty line ends it all.
"""

import hashlib
import os
import signal
import socket
import sys
import threading
from concurrent.futures import Future
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple
from unittest import mock

from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, EditLog, Outcome, Store, foundation, sweeping
from chunkserver.world import World
from tests.fault.disk import Disk, Fault

WORLD: Final = World(
    id="w", recipe=WorldRecipe(7, builtin("plane")), recipe_name="plane", generator="0123", epoch="0" * 32
)


STEP_ROWS: Final = 2
"""Of a foundation, and of a sweep: their steps are many."""


class Tally(NamedTuple):
    """A client's edits in its order: how many, and a digest of them all."""

    edits: int = 0
    digest: bytes = b""

    def and_one(self, seq: int, body: bytes) -> "Tally":
        return Tally(self.edits + 1, hashlib.sha256(self.digest + b"%d " % seq + body).digest())


def tallies(log: EditLog) -> tuple[int, dict[str, Tally]]:
    """Return the revision of the foundation, and what it says of each client."""
    revision, parts = log.foundation(WORLD.epoch)
    found = {}
    for name, content in parts:
        edits, _, digest = content.partition(b" ")
        found[name.decode()] = Tally(int(edits), digest)
    return revision, found


def compact(log: EditLog) -> None:
    """Fold the edits that are written into another foundation, and sweep."""
    revision, found = tallies(log)
    while edits := log.read(WORLD.epoch, revision):
        for edit in edits:
            assert edit.client is not None
            assert edit.seq is not None
            found[edit.client] = found.get(edit.client, Tally()).and_one(edit.seq, edit.strokes)
        revision = edits[-1].revision
    if not revision:
        return
    log.lay(WORLD.epoch, revision, ((name.encode(), b"%d %s" % tally) for name, tally in found.items()))
    while log.sweep():
        pass


def main(folder: Path, address: str) -> None:
    """Have one life after another, each as the next line of the input says."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen(64)
        _say("listening")
        for line in sys.stdin:
            if not line.strip():
                return
            child = os.fork()
            if child == 0:
                live(folder, listening, int(line))
                os._exit(0)
            _say(str(child))
            os.waitpid(child, 0)
            _say("ended")


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def live(folder: Path, listening: socket.socket, moment: int) -> None:
    """Serve until the process is killed, by itself or by another."""
    written = threading.Event()
    steps = [mock.patch.object(module, "STEP_ROWS_MAX", STEP_ROWS) for module in (foundation, sweeping)]
    with steps[0], steps[1], Disk(_deadly(moment)), closing(Store(folder)) as store:
        store.catalogue.create(WORLD)
        for _ in range(2):
            compact(store.log)  # what comes again now is below the floor
        threading.Thread(target=_compact_on, args=(store.log, written), daemon=True).start()
        while True:
            connection, _ = listening.accept()
            threading.Thread(target=_serve, args=(store, connection, written), daemon=True).start()


def _compact_on(log: EditLog, written: threading.Event) -> None:
    while written.wait():
        written.clear()
        compact(log)


def _deadly(moment: int) -> Fault:
    left = moment

    def count(kind: str, _name: str) -> None:
        nonlocal left
        if kind in ("sync", "synced"):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    return count


def _serve(store: Store, connection: socket.socket, written: threading.Event) -> None:
    """Take the edits of one client, in its order. Each is answered when it is written, while the next ones wait."""
    with connection, connection.makefile("rb") as lines:
        client = lines.readline().decode().strip()
        for line in lines:
            seq, _, body = line.partition(b" ")
            draft = Draft(epoch=WORLD.epoch, digest=body, strokes=body, stale=b"", client=client, seq=int(seq))
            store.writer.submit(draft).add_done_callback(partial(_answer, connection, int(seq), written))


def _answer(connection: socket.socket, seq: int, written: threading.Event, done: "Future[Outcome]") -> None:
    outcome = done.result()
    written.set()
    with suppress(OSError):  # the client has left
        connection.sendall(b"%d %d %d\n" % (seq, outcome.revision, outcome.duplicate))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
