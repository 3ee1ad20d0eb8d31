"""The real server over loopback, native format, two workers unless another number is named.

A closed loop: each connection sends its next request as soon as it has its answer. The client shares the cores of the
machine with the server and its workers. CPU time is per request; the server's is its own process's, without workers.

- Cold: every request is for another chunk at the surface of `terrain`; some are empty.
- Batch: the same in batches of 512 chunks, one after the other, on one connection. Times are a chunk's: from the
  request until its frame has come.
- Warm: the same 64 chunks, all with a surface, again and again, out of the server's memory.
- 304: the same with `If-None-Match`.
- Bare ASGI: an application that only looks the path up, on the same HTTP server, with the same headers and bytes. How
  many times ours it is stands behind its figures.
- FastAPI: an application as one writes it with FastAPI, path and query parameters typed and checked, on the same HTTP
  server, with the same headers and bytes, which lie ready in a dictionary.
"""

import http.client
import itertools
import json
import pickle
import random
import struct
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import httpx2

from benchmarks.bare import learn
from benchmarks.load import LOAD_SECONDS_MAX, Load, Request, send
from benchmarks.measure import MS, US, Figure, Line, Scale, in_turns
from benchmarks.scenes import SCENES, SEED, layers, prepare
from chunkserver.grid import ChunkKey
from tests.serving import Server, serving

WORKERS: Final = (1, 2)
CONNECTIONS: Final = 16
SIDE: Final = 200
"""Chunks a side of the two layers, 80,000 chunks, that cold requests are taken from."""

BATCH: Final = 512
"""Chunks of one."""

PEERS: Final = {", bare ASGI": "benchmarks.bare", ", FastAPI": "benchmarks.idiomatic"}
COMPARED: Final = ("requests", "server CPU")


class Turn(NamedTuple):
    """One round. servercpu_seconds: of the server's own process, without its workers."""

    load: Load
    servercpu_seconds: float


FIGURES: Final[dict[tuple[str, str], Callable[[Turn], float]]] = {
    ("requests", "1/s"): lambda turn: turn.load.answers / turn.load.seconds,
    ("median", "ms"): lambda turn: turn.load.quantile(0.5) * MS,
    ("99 %", "ms"): lambda turn: turn.load.quantile(0.99) * MS,
    ("client CPU", "us"): lambda turn: turn.load.cpu_seconds / turn.load.answers * US,
    ("server CPU", "us"): lambda turn: turn.servercpu_seconds / turn.load.answers * US,
    ("answer", "KB"): lambda turn: turn.load.bytes / turn.load.answers / 1000,
    ("empty", "%"): lambda turn: turn.load.statuses["204"] / turn.load.answers * 100,
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per kind of request, number of connections and, for cold ones, of workers."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        servers = {
            workers: stack.enter_context(serving(folder / f"{workers}.log", "--workers", str(workers)))
            for workers in WORKERS
        }
        ours = servers[max(WORKERS)]
        plain = [chunk_request(chunk.request.key) for chunk in prepare(SCENES["terrain surface"], scale.chunks)]
        with httpx2.Client(base_url=ours.url, headers={"Accept-Encoding": "identity"}) as client:
            answers = folder / "answers"
            answers.write_bytes(pickle.dumps(learn(client, [asked.path for asked in plain])))
            tagged = [Request(asked.path, client.get(asked.path).raise_for_status().headers["etag"]) for asked in plain]
        peers = {
            peer: stack.enter_context(serving(folder / module, str(answers), program=("-m", module)))
            for peer, module in PEERS.items()
        }
        kinds = {"warm": plain, "304": tagged}
        warm = _warm(ours, kinds, scale)
        for peer, server in peers.items():
            warm |= _warm(server, {f"{kind}{peer}": requests for kind, requests in kinds.items()}, scale)
        results = in_turns(_cold(servers, scale) | warm, scale.rounds)
    for subject, turns in results.items():
        beside = results[_without_peer(subject)] if _without_peer(subject) != subject else []
        yield Line(subject, tuple(_figure(name, unit, turns, beside) for name, unit in FIGURES))


def _without_peer(subject: str) -> str:
    """Return the subject of ours that a peer's stands beside."""
    for peer in PEERS:
        subject = subject.replace(peer, "")
    return subject


def _cold(servers: dict[int, Server], scale: Scale) -> dict[str, Callable[[], Turn]]:
    """Return the candidates whose every request is another chunk; each server is asked for the same ones."""
    keys = list(layers((-1, 0), SIDE))
    random.Random(SEED).shuffle(keys)
    most = max(servers)
    batch = partial(_batch_turn, servers[most], map(chunk_request, reversed(keys)), scale.cold_requests)
    turns: dict[str, Callable[[], Turn]] = {f"batch, {most} workers, 1 connection": batch}
    return turns | {
        f"cold, {workers} worker{'s'[: workers - 1]}, {CONNECTIONS} connections": partial(
            _fresh_turn, server, map(chunk_request, iter(keys)), scale.cold_requests
        )
        for workers, server in servers.items()
    }


def _batch_turn(server: Server, unasked: Iterator[Request], count: int) -> Turn:
    """Ask for so many chunks in batches on one connection."""
    before, load, started = cpu_seconds(server.child.pid), Load(), time.perf_counter()
    cpu_started = time.process_time()
    client = http.client.HTTPConnection(server.url.removeprefix("http://"), timeout=LOAD_SECONDS_MAX)
    while keys := [request.path.split("/")[-4:] for request in itertools.islice(unasked, min(BATCH, count))]:
        count -= len(keys)
        body = json.dumps({"chunks": [list(map(int, key)) for key in keys]})
        begun = time.perf_counter()
        client.request("POST", f"/v1/seeds/{SEED}/chunks", body, {"Content-Type": "application/json"})
        _count_frames(client.getresponse(), load, begun)
    client.close()
    load.seconds, load.cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
    load.latencies.sort()
    return Turn(load, cpu_seconds(server.child.pid) - before)


def _count_frames(answer: http.client.HTTPResponse, load: Load, begun: float) -> None:
    """Count the frames as docs/wire/batch-v1.md has them: 16 bytes, then headers of 64 with bodies padded to 16."""
    stream, at = bytearray(), 16
    while piece := answer.read1(1 << 18):
        stream += piece
        while len(stream) >= at + 64:
            body_bytes, index, status = struct.unpack_from("<IIH", stream, at)
            size = 64 + -(-body_bytes // 16) * 16
            if len(stream) < at + size:
                break
            at += size
            if index != 0xFFFFFFFF:
                load.count(str(status), time.perf_counter() - begun, size)
        del stream[:at]
        at = 0


def _fresh_turn(server: Server, unasked: Iterator[Request], count: int) -> Turn:
    return _turn(server, list(itertools.islice(unasked, count)), CONNECTIONS)


def _warm(server: Server, kinds: dict[str, list[Request]], scale: Scale) -> dict[str, Callable[[], Turn]]:
    """Return the candidates that ask for the same chunks again and again."""
    return {
        f"{name}, {connections} connection{'s' * (connections > 1)}": partial(
            _turn, server, list(itertools.islice(itertools.cycle(requests), scale.warm_requests)), connections
        )
        for name, requests in kinds.items()
        for connections in (CONNECTIONS, 1)
    }


def chunk_request(key: ChunkKey) -> Request:
    """Return the request for one chunk of `terrain`, in the native format."""
    return Request(f"/v1/seeds/{SEED}/chunks/{key.lod}/{key.x}/{key.y}/{key.z}")


def _turn(server: Server, requests: Sequence[Request], connections: int) -> Turn:
    before = cpu_seconds(server.child.pid)
    load = send(server.url, requests, connections)
    if load.answers != len(requests) or set(load.statuses) - {"200", "204", "304"}:
        raise RuntimeError(f"{len(requests)} requests had the answers {dict(load.statuses)}")
    return Turn(load, cpu_seconds(server.child.pid) - before)


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of all threads of another process, from the clock that clock_getcpuclockid(3) names."""
    return time.clock_gettime(~pid << 3 | 2)


def _figure(name: str, unit: str, turns: Sequence[Turn], ours: Sequence[Turn]) -> Figure:
    value = FIGURES[name, unit]
    ratios = tuple(value(a) / value(b) for a, b in zip(turns, ours, strict=True)) if ours and name in COMPARED else ()
    return Figure(name, unit, tuple(map(value, turns)), ratios)
