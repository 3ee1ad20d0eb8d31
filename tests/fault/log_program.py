"""A program that keeps a log of edits, for tests that kill it: `python -m tests.fault.log_program FOLDER SOCKET`.

It serves one line at a time to whoever connects, by the store that a server has:

    in    seq of the connection's client, and a body
    out   the seq, its revision, and 1 if it is a duplicate

For each life it forks, so that a new one begins within milliseconds. A line of its input says when that kills itself:
at which of the moments before and after its syncs; 0 is never. It prints the life's process id, and when that has
ended. An empty line ends it all.
"""

import os
import signal
import socket
import sys
import threading
from concurrent.futures import Future
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Final

from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Outcome, Store
from chunkserver.world import World
from tests.fault.disk import Disk, Fault

WORLD: Final = World(
    id="w", recipe=WorldRecipe(7, builtin("plane")), recipe_name="plane", generator="0123", epoch="0" * 32
)


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
    with Disk(_deadly(moment)), closing(Store(folder)) as store:
        store.catalogue.create(WORLD)
        while True:
            connection, _ = listening.accept()
            threading.Thread(target=_serve, args=(store, connection), daemon=True).start()


def _deadly(moment: int) -> Fault:
    left = moment

    def count(kind: str, _name: str) -> None:
        nonlocal left
        if kind in ("sync", "synced"):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    return count


def _serve(store: Store, connection: socket.socket) -> None:
    """Take the edits of one client, in its order. Each is answered when it is written, while the next ones wait."""
    with connection, connection.makefile("rb") as lines:
        client = lines.readline().decode().strip()
        for line in lines:
            seq, _, body = line.partition(b" ")
            draft = Draft(epoch=WORLD.epoch, digest=body, strokes=body, stale=b"", client=client, seq=int(seq))
            store.writer.submit(draft).add_done_callback(partial(_answer, connection, int(seq)))


def _answer(connection: socket.socket, seq: int, done: "Future[Outcome]") -> None:
    outcome = done.result()
    with suppress(OSError):  # the client has left
        connection.sendall(b"%d %d %d\n" % (seq, outcome.revision, outcome.duplicate))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
