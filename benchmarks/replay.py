"""Seconds until a server is ready whose world has a long log of edits, and until it answers a chunk of that world.

One world of `terrain`; 512 x 512 voxels of its ground are edited by `add` strokes of radius 4, 100 an edit. They are
sent to a server over HTTP, which is stopped when all of them are in the bricks. Then servers are started in that
folder, code compiled before. Ready is from the start of `chunkserver serve` to the first 200 of `/readyz`; the chunk
is one that the last edit has reached, and has to be the same to the byte as before the stop.

There is a target for 1,000,000 strokes: `--log-strokes 1000000`, which takes some minutes more.
"""

import itertools
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from benchmarks.editing import ADD_CONNECTIONS, ADDS, World, adds, options, requests
from benchmarks.load import send
from benchmarks.measure import Figure, Line, Scale
from tests.serving import READY_SECONDS_MAX, serving, until

SENT_AT_ONCE: Final = 1000
"""Edits; then it is waited until they are folded, as a server refuses more than some thousand that are not."""
STARTS_MAX: Final = 3


def run(scale: Scale) -> Iterator[Line]:
    """Yield one line: seconds until a server is ready, and until the chunk has come."""
    edits = -(-scale.log_strokes // ADDS)
    with tempfile.TemporaryDirectory() as folder:
        path, chunk = _filled(Path(folder), edits)
        starts = [_start(Path(folder), path, chunk) for _ in range(min(scale.starts, STARTS_MAX))]
    ready, first = (tuple(times) for times in zip(*starts, strict=True))
    yield Line(f"{ADDS * edits:,} strokes", (Figure("ready", "s", ready), Figure("first edited chunk", "s", first)))


def _filled(folder: Path, edits: int) -> tuple[str, bytes]:
    """Make a folder with a world of so many edits. Return the URL's path of a chunk of it, and the chunk."""
    with serving(folder / "log", *options(folder)) as server:
        world = World(server)
        world.create()
        left = itertools.islice(requests(world, adds, ADDS), edits)
        while some := list(itertools.islice(left, SENT_AT_ONCE)):
            load = send(server.url, some, ADD_CONNECTIONS)
            if set(load.statuses) != {"200"}:
                raise RuntimeError(f"{len(some)} edits had the answers {dict(load.statuses)}")
            chunk = world.settle()
        return f"{world.path}/chunks/0/0/0/0.mesh", chunk


def _start(folder: Path, path: str, chunk: bytes) -> tuple[float, float]:
    """Return the seconds until a server in the folder is ready, and until it has answered the chunk."""
    started = time.perf_counter()
    with serving(folder / "log", *options(folder), ready=False) as server:
        address = urlsplit(server.url).netloc
        until(partial(_get, address, "/readyz"), READY_SECONDS_MAX)
        ready = time.perf_counter() - started
        found = until(partial(_get, address, path), READY_SECONDS_MAX)
        first = time.perf_counter() - started
    if found != chunk:
        raise RuntimeError(f"{path} has {len(found)} bytes, which are not the {len(chunk)} that it had before the stop")
    return ready, first


def _get(address: str, path: str) -> bytes:
    """Return a body; nothing if the server cannot answer yet."""
    connection = HTTPConnection(address, timeout=READY_SECONDS_MAX)
    connection.request("GET", path)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return body if answer.status == 200 else b""
