"""The log of edits with its writer, beside the same log with a transaction for each edit. Both sync to the real disk.

An edit is opaque here: 80 bytes a stroke, and 300 of what it makes stale. It is acknowledged when its transaction is on
the disk. 8 threads send. While one transaction is synced, all edits that come wait, and are the next one.

- 1,000 a second: edits of one stroke, each sent at its time, whatever comes of those before; the time is from when it
  was due to its acknowledgement.
- As many as go: each thread has 64 edits under way. 100 strokes are one edit: a hundred times as many strokes.
- Not measured: HTTP, validation, what strokes do.
"""

import gc
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.measure import MS, Line, Scale, beside_first, in_turns
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Outcome, Store
from chunkserver.world import World

THREADS: Final = 8
PER_SECOND: Final = 1000
STROKE_BYTES: Final = 80
STALE_BYTES: Final = 300
UNDER_WAY: Final = 64
"""Of each thread."""
ROUNDS_MAX: Final = 5

Submit = Callable[[Draft], "Future[Outcome]"]
OURS: Final = "one thread, all that wait"
PEER: Final = "a transaction for each edit"


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for each kind of load and figure."""
    rounds = min(scale.rounds, ROUNDS_MAX)
    gc.collect()
    gc.freeze()  # what other benchmarks have imported is no load of this one: a server has a tenth of it
    with tempfile.TemporaryDirectory() as folder, _both(Path(folder)) as submits:
        timed = in_turns({name: partial(_at_a_rate, submit, scale) for name, submit in submits.items()}, rounds)
        for place, percent in enumerate(("median", "99 %")):
            values = {name: [turn[place] for turn in turns] for name, turns in timed.items()}
            yield Line(f"{PER_SECOND:,} edits a second, {percent}", beside_first(values, "ms"))
        for strokes in (1, 100):
            loads = {name: partial(_as_many_as_go, submit, strokes, scale) for name, submit in submits.items()}
            subject = f"as many as go, {strokes} stroke{'s' * (strokes > 1)} each"
            yield Line(subject, beside_first(in_turns(loads, rounds), "edits/s"))


@contextmanager
def _both(folder: Path) -> Iterator[dict[str, Submit]]:
    """Yield how an edit is sent to the writer, and how one after the other is written, each to a store of its own."""
    with (
        closing(_store(folder / "ours")) as ours,
        closing(_store(folder / "peer")) as peer,
        ThreadPoolExecutor(1) as executor,
    ):

        def alone(draft: Draft) -> "Future[Outcome]":
            return executor.submit(lambda: _written(peer, draft))

        yield {OURS: ours.writer.submit, PEER: alone}


def _store(folder: Path) -> Store:
    store = Store(folder)
    recipe = WorldRecipe(7, builtin("terrain"))
    store.catalogue.create(World(id="w", recipe=recipe, recipe_name="terrain", generator="0123", epoch="e"))
    return store


def _written(store: Store, draft: Draft) -> Outcome:
    (outcome,) = store.log.append([draft])
    assert isinstance(outcome, Outcome)
    return outcome


class _Client:
    """One of the threads: its own name and seqs, and when each of its edits was acknowledged."""

    _names = iter(range(1 << 30))

    def __init__(self, submit: Submit, strokes: int) -> None:
        self.submit, self.strokes = submit, bytes(STROKE_BYTES * strokes)
        self.name, self.seq = f"c{next(self._names)}", 0
        self.waits: list[float] = []

    def send(self, due: float) -> "Future[Outcome]":
        self.seq += 1
        draft = Draft(
            epoch="e",
            digest=bytes(16),
            strokes=self.strokes,
            stale=bytes(STALE_BYTES),
            client=self.name,
            seq=self.seq,
        )
        future = self.submit(draft)
        future.add_done_callback(lambda _: self.waits.append(time.perf_counter() - due))
        return future

    def send_at_a_rate(self, begin: float, count: int, per_second: float) -> None:
        futures = []
        for number in range(count):
            due = begin + number / per_second
            time.sleep(max(0.0, due - time.perf_counter()))
            futures.append(self.send(due))
        for future in futures:
            future.result()

    def send_all(self, count: int) -> None:
        room = threading.Semaphore(UNDER_WAY)
        futures = []
        for _ in range(count):
            room.acquire()
            futures.append(self.send(0.0))
            futures[-1].add_done_callback(lambda _: room.release())
        for future in futures:
            future.result()


def _at_a_rate(submit: Submit, scale: Scale) -> tuple[float, float]:
    """Return median and 99th percentile of the waits, in milliseconds."""
    clients = [_Client(submit, 1) for _ in range(THREADS)]
    count = int(scale.load_seconds * PER_SECOND / THREADS)
    begin = time.perf_counter() + 0.01
    with ThreadPoolExecutor(THREADS) as threads:
        own = [
            threads.submit(client.send_at_a_rate, begin + number / PER_SECOND, count, PER_SECOND / THREADS)
            for number, client in enumerate(clients)
        ]
        for one in own:
            one.result()
    median, late = np.percentile([wait for client in clients for wait in client.waits], (50, 99)) * MS
    return float(median), float(late)


def _as_many_as_go(submit: Submit, strokes: int, scale: Scale) -> float:
    """Return edits a second."""
    clients = [_Client(submit, strokes) for _ in range(THREADS)]
    count = scale.cold_requests
    begin = time.perf_counter()
    with ThreadPoolExecutor(THREADS) as threads:
        for one in [threads.submit(client.send_all, count) for client in clients]:
            one.result()
    return THREADS * count / (time.perf_counter() - begin)
