"""A game in virtual time: a `Session`, what it digs and what it shows; and all that it was told, written down."""

import random
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from chunkserver_client.mesh import ChunkKey
from chunkserver_client.retry import Retry
from chunkserver_client.stream import Ended, Event, Refresh, Region, Session, StartOver
from chunkserver_client.stream.messages import Message
from tests.sim.clock import Clock
from tests.sim.log import Strokes
from tests.sim.server import BAD, Server
from tests.sim.terrain import CELLS, CHUNKS, LODS
from tests.sim.wire import Frame, Wire

TURN_SECONDS = 0.08
HIGH = CELLS * CHUNKS


class Heard(NamedTuple):
    """A message as it came: at what time, on which connection, of which epoch, when what was known, where it looked."""

    at: float
    connection: int
    epoch: str | None
    known: int
    regions: tuple[Region, ...]
    message: Message


class _NotedSession(Session):
    """A session that has each message written down before it takes it."""

    note: Callable[[Message], None]

    def _take(self, message: Message) -> list[Event]:
        self.note(message)
        return super()._take(message)


class Player:
    """One player.

    heard: every message. sent: of each epoch, what was sent under each seq. shown: each chunk, as of which edit.
    slow: from when to when it read nothing. ends: when each connection ended.
    """

    def __init__(self, name: str, clock: Clock, rng: random.Random, server: Server) -> None:
        self.name = name
        self.heard: list[Heard] = []
        self.sent: dict[str, dict[int, Strokes]] = {}
        self.ended: Ended | None = None
        self.shown: dict[ChunkKey, int] = {}
        self.slow: list[tuple[float, float]] = []
        self.ends: dict[int, float] = {}
        self._clock, self._rng, self._server = clock, rng, server
        self._wire: Wire | None = None
        self._connections = 0
        retry = Retry(backoff_seconds=0.1, backoff_seconds_max=0.5)
        self.session = _NotedSession(name, [self.region()], CELLS, clock, retry, rng.uniform)
        self.session.note = self._write_down
        self._show_all()
        self._turn()

    def region(self) -> Region:
        first, last = sorted(self._rng.sample(range(CHUNKS + 1), 2))
        return Region((first * CELLS, 0, 0), (last * CELLS, 8, 8), self._rng.choice((0, 1, 20)))

    def dig(self) -> None:
        """Dig somewhere, or do what is refused."""
        if self.session.epoch is not None and self.ended is None:
            strokes = self._rng.choice((BAD, *6 * (self._dig(),), [*self._dig(), *self._dig()]))
            seq = self.session.edit(strokes)
            self.sent.setdefault(self.session.epoch, {})[seq] = strokes
            self._send()

    def look(self) -> None:
        """Look somewhere else."""
        if self._rng.random() < 0.5:
            self.session.subscribe(self.region())
        elif self.session.regions:
            self.session.unsubscribe(self._rng.choice(self.session.regions))
        self._send()

    def cut(self) -> None:
        if self._wire is not None:
            self._wire.cut()

    def doze(self, seconds: float) -> None:
        """Read nothing for a while."""
        if self._wire is not None:
            self._wire.pause(seconds)
            self.slow.append((self._clock.now, self._clock.now + seconds))

    def is_settled(self) -> bool:
        """Whether it has heard everything, and shows it."""
        return (
            self.session.is_live
            and not self.session.unanswered
            and (self.session.epoch, self.session.revision) == (self._server.log.epoch, self._server.log.revision)
            and self.session.are_regions_in_force
            and self.session.chunks.are_current
        )

    def _dig(self) -> Strokes:
        return [{"op": "dig", "at": self._rng.choice((None, *range(CHUNKS))), "id": self._rng.random()}]

    def _turn(self) -> None:
        if self.ended is None:
            if self._wire is not None and self.session.is_broken:
                self._wire.cut()
            if self.session.connect_at is not None and self.session.connect_at <= self._clock.now:
                self._connect()
            self._send()
            self._fetch()
            self._clock.after(TURN_SECONDS, self._turn)

    def _connect(self) -> None:
        if self._server.stream is None:
            self.session.lost()
            return
        self._connections += 1
        number = self._connections

        def end(code: int | None) -> None:
            if number == self._connections and self._wire is not None:
                self._wire = None
                self.ends[number] = self._clock.now
                self._note(self.session.lost(code))

        self._wire = Wire(self._clock, self._rng, self._server.stream, self._receive, end)
        self.session.connected()
        self._send()

    def _receive(self, frame: Frame) -> None:
        self._note(self.session.received(frame))
        self._send()

    def _note(self, events: object) -> None:
        for event in events if isinstance(events, list) else ():
            if isinstance(event, StartOver):
                self.shown.clear()
                self._show_all()
            elif isinstance(event, Ended):
                self.ended = event

    def _write_down(self, message: Message) -> None:
        session = self.session
        heard = (self._clock.now, self._connections, session.epoch, session.revision, session.regions, message)
        self.heard.append(Heard(*heard))

    def _show_all(self) -> None:
        for lod in LODS:
            for x in range(CHUNKS >> lod):
                self.session.chunks.add(ChunkKey(lod, x, 0, 0))

    def _send(self) -> None:
        if self._wire is not None:
            self._wire.send(self.session.outgoing())

    def _fetch(self) -> None:
        for refresh in self.session.chunks.take():
            self._clock.after(self._rng.uniform(0.01, 0.1), partial(self._fetched, refresh))

    def _fetched(self, refresh: Refresh) -> None:
        log = self._server.log
        if self._server.stream is None or log.epoch != self.session.epoch or log.revision < refresh.revision:
            self.session.chunks.failed(refresh)
            return
        for key in refresh.keys:
            self.shown[key] = log.last(key.lod, key.x)
        self.session.chunks.done(refresh, log.revision)
