"""A server in virtual time: `Stream` over a log that syncs now and then, and that crashes."""

import random
from collections.abc import Callable
from typing import Any

from chunkserver.stream import Connection, Stream, closing
from tests.sim.clock import Clock
from tests.sim.log import Log, Outcome, Strokes, stale_of

REPLAY_EDITS = 3
TICK_SECONDS = 0.08
BAD: Strokes = [{"op": "bad", "at": None}]

Drafts = list[tuple[Connection | None, str | None, int | None, Strokes]]


class Server:
    """A stream and its log; the journal of all connections. `stream` is None while the server is down."""

    def __init__(self, clock: Clock, rng: random.Random, new_stream: Callable[..., Stream] = Stream) -> None:
        self.clock, self.rng = clock, rng
        self.log = Log("epoch-0")
        self.logs = {self.log.epoch: self.log}
        self.stream: Stream | None = None
        self._new_stream = new_stream
        self._drafts: Drafts = []
        self._life = 0
        self.start()

    def start(self) -> None:
        if self.stream is None:
            self._life += 1
            self.stream = self._new_stream(self.log.epoch, self.log.revision, self, self.clock)
            self._tick(self._life)

    def crash(self) -> None:
        """Lose what is not synced; or have some of it synced, and nobody told."""
        if self.stream is not None:
            for _, client, seq, strokes in self._drafts[: self.rng.randint(0, len(self._drafts))]:
                self.log.append(client, seq, strokes)
            self._stop()

    def stop(self) -> None:
        """Go away as one should."""
        if self.stream is not None:
            self.stream.close()
            self._stop()

    def replace(self) -> None:
        """Be another world under the same id."""
        self.crash()
        self.log = Log(f"epoch-{len(self.logs)}")
        self.logs[self.log.epoch] = self.log
        for _ in range(self.rng.randint(0, 4)):
            self.log.append(None, None, [{"op": "dig", "at": 0}])

    def compact(self) -> None:
        self.log.floor = self.rng.randint(self.log.floor, self.log.revision)

    def post(self, strokes: Strokes) -> None:
        """Take an edit that did not come on a stream."""
        if self.stream is not None:
            self._draft(None, None, None, strokes)

    def introduce(self, connection: Connection, client: str) -> None:
        self._answer(lambda: connection.introduced(self.log.mark(client), self.log.floor))

    def submit(self, connection: Connection, client: str, seq: int, strokes: list[Any]) -> None:
        if strokes == BAD:
            connection.refused(seq, {"type": "bad", "title": "bad", "status": 422, "detail": "bad"})
        else:
            self._draft(connection, client, seq, strokes)

    def replay(self, connection: Connection, after: int) -> None:
        def answer() -> None:
            entries = self.log.read(after, REPLAY_EDITS)
            if entries is None:
                connection.compacted(self.log.floor)
            else:
                connection.replayed([entry.edit() for entry in entries], self.log.floor)

        self._answer(answer)

    def _answer(self, answer: Callable[[], None]) -> None:
        life = self._life
        self.clock.after(self.rng.uniform(0, 0.02), lambda: answer() if life == self._life else None)

    def _draft(self, connection: Connection | None, client: str | None, seq: int | None, strokes: Strokes) -> None:
        self._drafts.append((connection, client, seq, strokes))
        if len(self._drafts) == 1:
            self._answer(self._sync)

    def _sync(self) -> None:
        drafts, self._drafts = self._drafts, []
        for connection, client, seq, strokes in drafts:
            outcome = self.log.append(client, seq, strokes)
            if isinstance(outcome, Outcome) and not outcome.duplicate and self.stream is not None:
                self.stream.written(self.log.entries[-1].edit())
            elif connection is not None and seq is not None:
                self._tell(connection, seq, outcome)

    def _tell(self, connection: Connection, seq: int, outcome: Outcome | str) -> None:
        if isinstance(outcome, str):
            connection.refused(seq, {"type": "bad", "title": outcome, "status": 422, "detail": outcome})
        else:
            known = outcome.strokes is not None
            entry = self.log.entries[outcome.revision - 1]
            connection.repeated(seq, outcome.revision, stale_of(entry.strokes) if known else b"")

    def _tick(self, life: int) -> None:
        if life == self._life and self.stream is not None:
            self.stream.tick()
            self.clock.after(TICK_SECONDS, lambda: self._tick(life))

    def _stop(self) -> None:
        stream, self.stream, self._drafts = self.stream, None, []
        self._life += 1
        if stream is not None:
            stream.close(closing.FAILED)
