"""A server that is killed while it writes its disk cache: the next one opens it and finds what was written, whole."""

import os
import random
import signal
import subprocess
import sys
from itertools import count as counted_from
from pathlib import Path

from chunkserver.pipeline import Chunk
from chunkserver.server.chunk_file import claim, give_back, open_claimed
from tests.conftest import SEED
from tests.scale import count

KILLS = 3000
BYTES_MAX = 4 << 20
BATCH = 10
RECENT = 50
"""Of the newest chunks, how many are looked for; the file has room for more."""
SECONDS_MAX = 0.03
"""How long a server writes before it is killed, at most."""


def key(number: int) -> bytes:
    return number.to_bytes(16, "little")


def chunk(number: int) -> Chunk:
    return Chunk("surface", random.Random(number).randbytes(number % 7 * 5000))


def write_on(folder: Path, first: int, pipe: int) -> None:
    """Write chunks until killed, and say on the pipe after each batch how many there are now."""
    file = open_claimed(folder, BYTES_MAX, claim(folder))
    for start in counted_from(first, BATCH):
        file.write([(key(number), chunk(number)) for number in range(start, start + BATCH)])
        os.write(pipe, (start + BATCH).to_bytes(8, "little"))


def killed(folder: Path, written: int, after_seconds: float) -> int:
    """Fork a server, kill it while it writes, and return how many chunks it said it had written, of all."""
    reading, writing = os.pipe()
    server = os.fork()
    if not server:
        write_on(folder, written, writing)
    os.close(writing)
    said = os.read(reading, 8)  # it runs
    signal.setitimer(signal.ITIMER_REAL, after_seconds)
    signal.sigwait({signal.SIGALRM})
    os.kill(server, signal.SIGKILL)
    os.waitpid(server, 0)
    while rest := os.read(reading, 1 << 16):
        said = rest[-8:]
    os.close(reading)
    return int.from_bytes(said, "little")


def look(folder: Path, written: int) -> None:
    """Be the next server: everything that is found is what was written, the newest included."""
    lock = claim(folder)
    file = open_claimed(folder, BYTES_MAX, lock)
    found = {number: file.read(key(number)) for number in range(max(0, written - 4 * RECENT), written + BATCH)}
    assert all(value in (None, chunk(number)) for number, value in found.items())
    assert all(found[number] for number in range(max(0, written - RECENT), written)), written
    assert file.bytes <= BYTES_MAX
    file.close()
    give_back(lock, whole=False)  # all pages are checked by whoever comes


def main(folder: Path, kills: int, seed: int) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    when, written = random.Random(seed), 0
    for _ in range(kills):
        written = killed(folder, written, when.uniform(0.0005, SECONDS_MAX))
        look(folder, written)
    sys.stdout.write(str(written))


def test_killed_while_writing(tmp_path):
    """One process imports everything once, then forks the servers."""
    kills = count(KILLS)
    command = [sys.executable, "-m", "tests.fault.test_disk_killed", str(tmp_path), str(kills), str(SEED)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert int(answer.stdout) > 2 * kills * BATCH


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
