"""A process of its own that measures when it is told to: for two processes at once, and for two versions in turns.

Run as `python -m benchmarks.remote`: each line on its standard input names a job of `JOBS`, and is answered by a line
with a number, milliseconds per chunk. The first answer says which chunkserver it measures.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import IO, Final

import chunkserver
from benchmarks import stages
from benchmarks.measure import FULL, MS, timed
from benchmarks.scenes import SCENES, Ready, prepare

ROOT: Final = Path(__file__).parents[1]
END_SECONDS_MAX: Final = 30.0
JOBS: Final = tuple(f"{scene}: {stage}" for scene in SCENES for stage in stages.STAGES)


class Remote:
    """One such process. `begin` and `end` are two calls, so that two of them can work at once."""

    def __init__(self, child: subprocess.Popen[str]) -> None:
        if child.stdin is None or child.stdout is None:
            raise ValueError("the child has no pipes")
        self.child, self._asks, self._answers = child, child.stdin, child.stdout
        self.package = self._answer()

    def begin(self, job: str) -> None:
        """Let it begin one turn of a job of `JOBS`."""
        with suppress(BrokenPipeError):  # `end` says that the process has ended
            os.write(self._asks.fileno(), f"{job}\n".encode())

    def end(self) -> float:
        """Wait for the turn's end and return milliseconds per chunk. Raises RuntimeError if the process has ended."""
        return float(self._answer())

    def turn(self, job: str) -> float:
        """Return milliseconds per chunk of one turn."""
        self.begin(job)
        return self.end()

    def _answer(self) -> str:
        line = self._answers.readline().strip()
        if not line:
            raise RuntimeError(f"a measuring process ended with exit code {self.child.wait(END_SECONDS_MAX)}")
        return line


@contextmanager
def remote(chunks: int = FULL.chunks, checkout: Path = ROOT, cache_dir: Path | None = None) -> Iterator[Remote]:
    """Start a process, and end it whatever happens.

    chunks: how many are in rotation.
    checkout: the folder whose `chunkserver` it measures; the benchmarks are always ours.
    cache_dir: where its compiled code is kept; the usual folder if None.
    """
    paths = os.pathsep.join([str(checkout), str(ROOT)])
    environment = {**os.environ, "PYTHONPATH": paths}
    if cache_dir:
        environment["CHUNKSERVER_CACHE_DIR"] = str(cache_dir)
    command = [sys.executable, "-P", "-m", "benchmarks.remote", str(chunks)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as child:
        try:
            yield Remote(child)
        finally:
            child.kill()


def serve(chunks: int, asks: IO[str], answers: IO[str]) -> None:
    """Answer lines until there are no more."""
    ready = cache(partial(_candidate, chunks))
    print(Path(chunkserver.__file__).parent, file=answers, flush=True)
    for line in asks:
        print(ready(line.strip())(), file=answers, flush=True)


def _candidate(chunks: int, job: str) -> Callable[[], float]:
    scene, _, stage = job.partition(": ")
    return timed(stages.STAGES[stage], _rotation(scene, chunks), MS)


@cache
def _rotation(scene: str, chunks: int) -> list[Ready]:
    return prepare(SCENES[scene], chunks)


if __name__ == "__main__":
    serve(int(sys.argv[1]), sys.stdin, sys.stdout)
