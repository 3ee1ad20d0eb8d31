"""The real server in a process of its own: started on a free port, stopped by SIGTERM, its log read to the end.

@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("server") / "log") as running:
        yield running
"""

import os
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import httpx2

SERVE: Final = ("-m", "chunkserver", "serve", "--port", "0")
START_SECONDS_MAX: Final = 120.0
"""Until it listens: Python's imports, on a busy machine."""
READY_SECONDS_MAX: Final = 120.0
"""Until /readyz says yes: the kernels may have to be compiled, on cores that other tests use too."""
STOP_SECONDS_MAX: Final = 30.0
POLL_SECONDS: Final = 0.02
MARK: Final = "MARK_OF_A_TEST"
"""Set for the server and so for all its children: what is left of them is found by it."""

_LISTENS: Final = re.compile(r" on (http://\S+);")
_TIME: Final = r"""(?:{"time": ")?\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z(?:", "level": "| )"""
"""Of a line of text, and of one of JSON."""

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class Server:
    """A running server."""

    url: str
    log: Path
    child: subprocess.Popen[bytes]

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        self.child.send_signal(number)
        return self.child.wait(STOP_SECONDS_MAX)


@contextmanager
def serving(
    log: Path, *options: str, program: tuple[str, ...] = SERVE, ready: bool = True, expected: str = r"(?!)"
) -> Iterator[Server]:
    """Run the server with `options`; at the end its log is clean, its exit code 0, and no process of it is left.

    program: what Python runs; another one than `chunkserver serve` says its URL in the log in the same way.
    ready: wait until /readyz answers 200.
    expected: a pattern of what else lines of the log may begin with behind the time.
    """
    mark = secrets.token_hex(16)
    environment = {**os.environ, MARK: mark, "PYTHONUNBUFFERED": "1"}
    with log.open("wb") as sink:
        child = subprocess.Popen(
            [sys.executable, *program, *options], stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, env=environment
        )
    try:
        url = until(lambda: _listens(log, child), START_SECONDS_MAX, "the server listens")
        server = Server(url, log, child)
        if ready:
            until(lambda: _is_ready(server), READY_SECONDS_MAX, "/readyz answers 200")
        yield server
        code = server.stop() if child.poll() is None else child.returncode
        assert code == 0, f"the server ended with exit code {code}"
        clean = re.compile(rf"{_TIME}(INFO\b|{expected})")
        unclean = [line for line in log.read_text().splitlines() if not clean.match(line)]
        assert not unclean, f"{len(unclean)} lines of the log are not clean"
        until(lambda: not processes_of(mark), STOP_SECONDS_MAX, "no process of the server is left")
    except BaseException as error:
        error.add_note(f"the server's log:\n{log.read_text()}")
        raise
    finally:
        for pid in processes_of(mark):
            os.kill(pid, signal.SIGKILL)
        child.wait()


def until(condition: Callable[[], _Value], seconds: float, what: str = "the condition holds") -> _Value:
    """Return the first true value of `condition`. Raises `TimeoutError`, which says `what`, after `seconds` without."""
    deadline = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {seconds:g} s: {what}")
        time.sleep(POLL_SECONDS)


def processes_of(mark: str) -> list[int]:
    """Return the processes that inherited `MARK=mark`; those that have ended have no environment any more."""
    wanted = f"{MARK}={mark}".encode()
    return [pid for pid in _pids() if wanted in _environment(pid)]


def _pids() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()]


def _environment(pid: int) -> list[bytes]:
    try:
        return Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return []


def _listens(log: Path, child: subprocess.Popen[bytes]) -> str:
    found = _LISTENS.search(log.read_text())
    if found is None and child.poll() is not None:
        raise RuntimeError(f"the server ended with exit code {child.returncode}")
    return found[1] if found else ""


def _is_ready(server: Server) -> bool:
    if server.child.poll() is not None:
        raise RuntimeError(f"the server ended with exit code {server.child.returncode}")
    return httpx2.get(f"{server.url}/readyz").status_code == 200
