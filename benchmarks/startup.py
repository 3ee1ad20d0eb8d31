"""Seconds until a server is ready, and how much memory its processes take.

Imports are in a new process, Python's own start included. Ready is from the start of `chunkserver serve` to the first
200 of `/readyz`. Memory is after cold chunks, and only the pages that no other process shares.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from typing import Final
from unittest.mock import patch
from urllib.parse import urlsplit

from benchmarks.load import send
from benchmarks.measure import Figure, Line, Scale, in_turns
from benchmarks.scenes import SEED, layers
from benchmarks.service import CONNECTIONS, chunk_request
from chunkserver.worker import warm
from tests.serving import READY_SECONDS_MAX, serving, until

IMPORTED: Final = {
    "Python alone": "sys",
    "chunkserver.server": "chunkserver.server",
}
WORKERS: Final = 2
MEGABYTE: Final = 1e6


def run(scale: Scale) -> Iterator[Line]:
    """Yield lines of seconds until something is imported or ready, and of the memory of a server's processes."""
    candidates: dict[str, Callable[[], float]] = {
        f"import, {name}": partial(_import_seconds, module) for name, module in IMPORTED.items()
    }
    candidates["ready, code on disk"] = _ready_seconds
    warm()
    for subject, seconds in in_turns(candidates, scale.starts, uncounted=0).items():
        yield Line(subject, (Figure("time", "s", tuple(seconds)),))
    if scale.compiles:
        seconds = [_compile_seconds() for _ in range(scale.compiles)]
        yield Line("ready, nothing compiled", (Figure("time", "s", tuple(seconds)),))
    for subject, megabytes in _private_megabytes(scale.cold_requests).items():
        yield Line(subject, (Figure("private memory", "MB", megabytes),))


def _import_seconds(module: str) -> float:
    started = time.perf_counter()
    subprocess.run([sys.executable, "-c", f"import {module}"], check=True)
    return time.perf_counter() - started


def _ready_seconds() -> float:
    """Return the time from the start of a server to its first yes."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        with serving(Path(folder) / "log", "--workers", str(WORKERS), ready=False) as server:
            until(partial(_is_ready, urlsplit(server.url).netloc), READY_SECONDS_MAX)
            return time.perf_counter() - started


def _compile_seconds() -> float:
    with tempfile.TemporaryDirectory() as folder, patch.dict(os.environ, CHUNKSERVER_CACHE_DIR=folder):
        return _ready_seconds()


def _is_ready(address: str) -> bool:
    connection = HTTPConnection(address)
    connection.request("GET", "/readyz")
    ready = connection.getresponse().status == 200
    connection.close()
    return ready


def _private_megabytes(requests: int) -> dict[str, tuple[float, ...]]:
    """Return the memory of each process of a server that has built so many chunks; for workers, of each of them."""
    keys = random.Random(SEED).sample(layers((-1, 0), 60), requests)
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "log", "--workers", str(WORKERS)) as server:
        send(server.url, list(map(chunk_request, keys)), CONNECTIONS)
        (fork_server,) = _children(server.child.pid)
        workers = _children(fork_server)
        return {
            f"server, {requests} chunks in its cache": (_megabytes(server.child.pid),),
            "fork server": (_megabytes(fork_server),),
            f"each of {len(workers)} workers": tuple(map(_megabytes, workers)),
        }


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def _megabytes(pid: int) -> float:
    """Return the memory that ends with this process: pages that no other one shares."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    kilobytes = [int(line.split()[1]) for line in lines if line.startswith(("Private_Clean:", "Private_Dirty:"))]
    return sum(kilobytes) * 1024 / MEGABYTE
