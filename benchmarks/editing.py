"""Edits over HTTP: the real server with two workers, which syncs each edit to the real disk before it acknowledges it.

Each turn has a new world of `terrain`, with edits on 512 x 512 voxels of its ground. The client shares the cores of the
machine with the server and its workers.

- Carves are balls of radius 6. They come at a fixed rate over as many connections as that takes, whatever becomes of
  those before; the time is from when an edit was due to its acknowledgement. Lost: edits without one.
- Most within 25 ms: the highest rate of single carves of which 99 % take no longer, over some seconds, to a sixth.
- Adds are what a brush leaves that is drawn over 50 voxels: 100 balls of radius 4, one edit. 8 connections send one
  edit after the other; then a chunk is asked for that a last one has reached, which comes behind all others.
  Acknowledged and folded: strokes a second, up to that chunk's last byte.
- Visible: a carve alone, until a client has the bytes of all stale chunks of LOD 0, which it asks for in one batch.
  Several such carves follow each other on one connection.
"""

import itertools
import json
import random
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks.load import LOAD_SECONDS_MAX, Load, Request, offer, send_for
from benchmarks.measure import MS, Figure, Line, Scale, in_turns
from benchmarks.service import cpu_seconds
from tests.serving import Server, serving, until

WORKERS: Final = 2
SEED: Final = 42
SIDE: Final = 512.0
"""Voxels a side of where edits are."""
CARVES_PER_SECOND: Final = 1000
LATE_MS: Final = 25.0
RATES: Final = tuple(round(100 * 2 ** (step / 4)) for step in range(21))
"""Edits a second that are tried, 100 to 3,200."""
SEARCH_SHARE: Final = 0.5
"""Of the seconds of a turn, for each rate that is tried."""
ADDS: Final = 100
"""Strokes of an edit."""
ADD_CONNECTIONS: Final = 8
ADD_SECONDS: Final = 2.0
"""Times the seconds of another turn: to be sustained."""
VISIBLE_SHARE: Final = 0.25
"""Of the cold requests of a round: so many carves are looked at, one after the other."""
ROUNDS_MAX: Final = 3
"""Each takes about half a minute."""

Stroke = dict[str, Any]


class Carves(NamedTuple):
    """What came of carves at a fixed rate. server_cpu_seconds: of the server's own process, without its workers."""

    load: Load
    server_cpu_seconds: float

    @property
    def late(self) -> float:
        """The time, in milliseconds, that 99 % of them took at most; endless if any was lost."""
        return self.load.quantile(0.99) * MS if not self.lost else float("inf")

    @property
    def lost(self) -> int:
        """Edits that were not acknowledged."""
        return self.load.statuses.total() - self.load.statuses["200"]


CARVE_FIGURES: Final[dict[tuple[str, str], Callable[[Carves], float]]] = {
    ("acknowledged", "1/s"): lambda turn: turn.load.statuses["200"] / turn.load.seconds,
    ("median", "ms"): lambda turn: turn.load.quantile(0.5) * MS,
    ("99 %", "ms"): lambda turn: turn.load.quantile(0.99) * MS,
    ("lost", ""): lambda turn: float(turn.lost),
    ("server CPU", "us"): lambda turn: turn.server_cpu_seconds / max(turn.load.answers, 1) * 1e6,
}


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for each kind of edit."""
    rounds, seconds = min(scale.starts, ROUNDS_MAX), scale.load_seconds
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "log", *options(Path(folder))) as server:
        visible(server, 1)  # a server's first edit waits for compiled code to be loaded
        at_a_rate = {
            f"{CARVES_PER_SECOND:,} carves a second, {count} an edit": partial(
                carve_at, server, CARVES_PER_SECOND // count, count, seconds
            )
            for count in (1, 10)
        }
        for subject, turns in in_turns(at_a_rate, rounds, uncounted=0).items():
            figures = [Figure(*name, tuple(map(value, turns))) for name, value in CARVE_FIGURES.items()]
            yield Line(subject, tuple(figures))
        others: dict[str, Callable[[], Sequence[float]]] = {
            "most": lambda: [most_in_time(server, SEARCH_SHARE * seconds)],
            "adds": lambda: [add_for(server, ADD_SECONDS * seconds)],
            "visible": lambda: visible(server, max(1, int(scale.cold_requests * VISIBLE_SHARE))),
        }
        found = {name: list(zip(*turns, strict=True)) for name, turns in in_turns(others, rounds, uncounted=0).items()}
    yield Line("carves, 1 an edit", (Figure(f"most within {LATE_MS:g} ms", "1/s", *found["most"]),))
    yield Line(f"adds, {ADDS} an edit", (Figure("acknowledged and folded", "strokes/s", *found["adds"]),))
    names = (("visible, median", "ms"), ("visible, 90 %", "ms"), ("stale chunks", "of LOD 0"))
    seen = zip(names, found["visible"], strict=True)
    yield Line("a carve, then its chunks", tuple(Figure(*name, values) for name, values in seen))


def options(folder: Path) -> tuple[str, ...]:
    """Return those of a server that keeps its worlds in a folder."""
    return "--workers", str(WORKERS), "--data", str(folder / "data")


class World:
    """A world of a running server, over a connection of its own. Each request has to be answered well."""

    _names = itertools.count()

    def __init__(self, server: Server) -> None:
        self.path = f"/v1/worlds/w{next(self._names)}"
        self._connection = HTTPConnection(server.url.removeprefix("http://"), timeout=LOAD_SECONDS_MAX)

    def create(self) -> None:
        """Create it, and have its edits opened."""
        self._ask("POST", "/v1/worlds", {"id": self.path.rpartition("/")[2], "seed": SEED, "recipe": "terrain"})
        self.settle()

    def close(self) -> None:
        """Delete it."""
        self._ask("DELETE", self.path)
        self._connection.close()

    def edit(self, strokes: Sequence[Stroke]) -> Any:
        """Return the answer to an edit."""
        return json.loads(self._ask("POST", f"{self.path}/edits", {"strokes": strokes}))

    def batch(self, keys: Sequence[Sequence[int]]) -> bytes:
        """Return the frames of some chunks."""
        return self._ask("POST", f"{self.path}/chunks", {"chunks": keys})

    def chunk(self, key: Sequence[int], revision: str) -> bytes:
        """Return a chunk at a revision or later."""
        return self._ask("GET", f"{self.path}/chunks/{'/'.join(map(str, key))}.mesh?min_revision={revision}")

    def settle(self) -> bytes:
        """Return, when all edits so far are in the bricks, the chunk of one more, which comes behind them."""
        self._connection.close()  # the server may have, if it was not used for long: the next request opens it
        x, y, z = 16.0, 0.0, 16.0
        answer = self.edit([{"op": "add", "shape": "sphere", "center": [x, y, z], "radius": 3.0, "strength": 0.01}])
        return until(partial(self._try_chunk, (0, 0, 0, 0), answer["revision"]), LOAD_SECONDS_MAX, "edits are folded")

    def _try_chunk(self, key: Sequence[int], revision: str) -> bytes:
        try:
            return self.chunk(key, revision)
        except ConnectionError:  # it took longer than the server lets a chunk wait
            return b""

    def _ask(self, method: str, path: str, body: object = None) -> bytes:
        headers = {} if body is None else {"Content-Type": "application/json"}
        self._connection.request(method, path, None if body is None else json.dumps(body), headers)
        answer = self._connection.getresponse()
        content = answer.read()
        if not 200 <= answer.status < 300:
            raise ConnectionError(f"{method} {path} was answered {answer.status}: {content[:500]!r}")
        return content


@contextmanager
def new_world(server: Server) -> Iterator[World]:
    """Yield a new world; delete it when its edits are folded, so that they burden nobody else."""
    world = World(server)
    world.create()
    yield world
    world.settle()
    world.close()


def carves(count: int, at: random.Random) -> list[Stroke]:
    """Return as many carves near the ground."""
    return [{"op": "carve", "shape": "sphere", "center": _place(at), "radius": 6.0} for _ in range(count)]


def adds(count: int, at: random.Random) -> list[Stroke]:
    """Return what a brush leaves that is drawn along x."""
    x, y, z = _place(at)
    strength = at.choice((-0.5, 0.5))
    return [
        {"op": "add", "shape": "sphere", "center": [x + step / 2, y, z], "radius": 4.0, "strength": strength}
        for step in range(count)
    ]


def _place(at: random.Random) -> list[float]:
    x, z = (round(at.uniform(-SIDE / 2, SIDE / 2), 2) for _ in range(2))
    return [x, round(at.uniform(-16.0, 8.0), 2), z]


def requests(world: World, make: Callable[[int, random.Random], list[Stroke]], strokes: int) -> Iterator[Request]:
    """Yield edits of so many strokes without end, the same in every run."""
    at = random.Random(SEED)
    while True:
        yield Request(f"{world.path}/edits", body=json.dumps({"strokes": make(strokes, at)}).encode())


def carve_at(server: Server, rate: float, count: int, seconds: float) -> Carves:
    """Send edits of `count` carves at a rate, edits a second."""
    with new_world(server) as world:
        ready = list(itertools.islice(requests(world, carves, count), int(rate * seconds)))
        before = cpu_seconds(server.child.pid)
        load = offer(server.url, ready, rate, seconds)
        return Carves(load, cpu_seconds(server.child.pid) - before)


def most_in_time(server: Server, seconds: float) -> float:
    """Return the highest of RATES at which 99 % of single carves take LATE_MS at most; 0 if there is none."""
    low, high = -1, len(RATES)  # RATES[low] is in time, RATES[high] is not
    while high - low > 1:
        middle = (low + high) // 2
        in_time = carve_at(server, RATES[middle], 1, seconds).late <= LATE_MS
        low, high = (middle, high) if in_time else (low, middle)
    return float(RATES[low]) if low >= 0 else 0.0


def add_for(server: Server, seconds: float) -> float:
    """Return strokes a second that are acknowledged and folded, of those that are sent for so long."""
    with new_world(server) as world:
        started = time.perf_counter()
        load = send_for(server.url, requests(world, adds, ADDS), ADD_CONNECTIONS, seconds)
        world.settle()
        return ADDS * load.statuses["200"] / (time.perf_counter() - started)


def visible(server: Server, count: int) -> tuple[float, float, float]:
    """Return median and 90th percentile of the time until a carve is visible, milliseconds; and how many chunks."""
    at, waits, chunks = random.Random(SEED), [], 0
    with new_world(server) as world:
        for _ in range(count):
            strokes = carves(1, at)
            started = time.perf_counter()
            keys = list(stale_keys(world.edit(strokes)["stale"], 0))
            if keys:
                world.batch(keys)
            waits.append((time.perf_counter() - started) * MS)
            chunks += len(keys)
    waits.sort()
    return waits[len(waits) // 2], waits[int(0.9 * len(waits))], chunks / count


def stale_keys(stale: Sequence[Any], lod: int) -> Iterator[tuple[int, ...]]:
    """Yield the keys of the chunks of a level that an edit has made stale."""
    for found in stale:
        if found["lod"] == lod:
            spans = (range(low, high + 1) for low, high in zip(found["min"], found["max"], strict=True))
            yield from ((lod, *place) for place in itertools.product(*spans))
