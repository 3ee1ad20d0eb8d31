"""Loads on a world's stream of edits: one row a storm. Who joins, edits and is cut follows from the options."""

import asyncio
import gc
import itertools
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from chunkserver_loadtest.crowd import NOT_WELCOME, OK, POLL_SECONDS, Crowd
from chunkserver_loadtest.errors import BadTarget
from chunkserver_loadtest.exchange import Answer, Exchange, Request
from chunkserver_loadtest.generator import Limits
from chunkserver_loadtest.machine import allow_files
from chunkserver_loadtest.peer import DISORDERED, MALFORMED
from chunkserver_loadtest.profiles import Options, arrivals
from chunkserver_loadtest.record import Histogram, Record
from chunkserver_loadtest.result import MS, Stream, percentiles
from chunkserver_loadtest.target import Target
from chunkserver_loadtest.tellings import EVERYWHERE, Look, Sent, Strokes, Verdict
from chunkserver_loadtest.world import World

LOOKS: Final = 16
"""Places where subscribers look who do not look everywhere; they are dealt out in turns."""
RELIEF: Final = 1 / 32
"""Of the ground that is edited: how far above and below its middle edits are."""
RADIUS: Final = 6.0
FILES: Final = 256
"""Open files beside connections."""
NAME_BYTES: Final = 4
BYTES_SECONDS: Final = 0.25
"""How often it is counted how many bytes have come."""
NOTHING: Final = Verdict(0, 0, 0, 0)
LOSSES: Final = {NOT_WELCOME: "no-welcome", DISORDERED: "disordered", MALFORMED: "malformed-message"}
"""Kinds of failure by why a peer was lost; any other is `peer-lost`."""


@dataclass(frozen=True)
class Setting:
    """Where a storm is. fixed: header lines of each request. is_own: nobody else edits this world.

    revision: asks the server for the world's.
    """

    target: Target
    world: World
    fixed: bytes
    options: Options
    limits: Limits
    closed: bool
    is_own: bool
    revision: Callable[[], int]


@dataclass
class Facts:
    """What a storm finds beside answers. told, last: from answers, to each and to the last who was told.

    welcomed, back: of each who was cut, from when all came back until it was welcome, and knew everything. all_back: of
    each cut, until all knew everything. Durations in seconds.
    """

    crowd: Crowd
    told: Histogram = field(default_factory=Histogram)
    last: Histogram = field(default_factory=Histogram)
    welcomed: Histogram = field(default_factory=Histogram)
    back: Histogram = field(default_factory=Histogram)
    all_back: list[float] = field(default_factory=list)
    verdict: Verdict = NOTHING

    def told_of(self, options: Options) -> Stream:
        """Return what a result says of them."""
        crowd, verdict = self.crowd, self.verdict
        return Stream(
            editors=options.editors,
            subscribers=options.subscribers,
            silent=round(options.silent * options.subscribers),
            gone=len(crowd.gone),
            lost=len(crowd.lost),
            acknowledged=crowd.acknowledged,
            duplicates=crowd.duplicates,
            nacks=dict(crowd.nacks),
            missed=verdict.missed,
            late=verdict.late,
            strange=verdict.strange,
            stale=crowd.stale,
            resync=crowd.resync,
            connects=crowd.connects,
            refused=dict(crowd.refusals),
            told=percentiles(self.told),
            last=percentiles(self.last),
            welcomed=percentiles(self.welcomed),
            back=percentiles(self.back),
            all_back=[seconds * MS for seconds in self.all_back],
        )


class Stage:
    """A storm while it goes on: the crowd, what it does, and what is written down of it.

    seconds, cuts: for how long it is to edit, and how often it is to be cut.
    """

    def __init__(self, setting: Setting, record: Record) -> None:
        self._setting, self._record = setting, record
        options, name = setting.options, secrets.token_hex(NAME_BYTES)
        silent = round(options.silent * options.subscribers)
        self._editors = [f"{name}-editor-{number}" for number in range(options.editors)]
        self._subscribers = [f"{name}-subscriber-{number}" for number in range(options.subscribers - silent)]
        self._silent = [f"{name}-silent-{number}" for number in range(silent)]
        self._request = Request(f"{setting.world.path}/stream", "edit")
        self._strokes = self._drawn()
        self._turns = itertools.cycle(self._editors)
        self._counted_at = 0.0
        self._left = setting.limits.requests
        crowd = Crowd(
            *(setting.target, setting.world.path, setting.fixed),
            cells=setting.world.cells,
            patience=setting.limits.timeout,
            answered=self._answered,
            told=self._told,
        )
        self.facts = Facts(crowd)
        self.seconds, self.cuts = setting.limits.seconds, options.cuts
        self._crowd = crowd

    async def join(self) -> None:
        """Have all peers join, and a first edit answered. Raises BadTarget if that cannot be."""
        allow_files(len(self._editors) + len(self._subscribers) + len(self._silent) + FILES)
        crowd, looks = self._crowd, self._looks()
        try:
            await crowd.join(self._editors, edit=True)
            for number, look in enumerate(looks):
                await crowd.join(self._subscribers[number :: len(looks)], look=look)
            await crowd.join(self._silent, silent=True)
            await self._edit_aside(1)
        except ConnectionError as error:
            raise BadTarget(f"{self._request.path}: {error}") from None

    async def edit(self, seconds: float) -> None:
        """Have edits sent for so long: when they are due, or each editor's next when it has its answer."""
        begun = time.perf_counter()
        if self._setting.closed:
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds + self._setting.limits.timeout):
                    await asyncio.gather(*(self._edit_on(name, begun + seconds) for name in self._editors))
            return
        for at in itertools.takewhile(lambda at: at < seconds, arrivals(self._setting.options)):
            await asyncio.sleep(max(0.0, begun + at - time.perf_counter()))
            names = filter(self._is_there, itertools.islice(self._turns, len(self._editors)))
            if (name := next(names, None)) is None or not self._left:
                return
            self._send(name, begun + at)

    async def cut(self) -> None:
        """Have all but one editor lose their connections, miss some edits of that one, and come back at once."""

        async def away() -> None:
            with suppress(ConnectionError):  # that the editor is lost is told at the end
                await self._edit_aside(self._setting.options.missed)

        backs = await self._crowd.come_back(away, self._editors[1:])
        for back in backs:
            self.facts.welcomed.add(back.welcomed)
            if not back.is_editor:
                self.facts.back.add(back.caught_up)
        if backs:
            self.facts.all_back.append(max(back.caught_up for back in backs))

    async def end(self) -> None:
        """Wait until everything is answered and told, or `timeout`; and write down what was not as it has to be."""
        crowd = self._crowd
        await crowd.settle(self._setting.limits.timeout)
        await crowd.notice()
        unanswered = crowd.forget()
        for sent in unanswered:
            exchange = self._exchange(sent, time.perf_counter())
            exchange.failure, exchange.detail = "timeout", "no answer when the load ended"
            if sent.is_aside:
                self._record.fail(exchange, exchange.failure, exchange.detail)
            else:
                self._record.ended(exchange)
        for name, loss in crowd.lost.items():
            self._fail(LOSSES.get(loss.kind, "peer-lost"), 1, f"{name}: {loss.detail}")
        found = crowd.verdict()
        found = self.facts.verdict = found._replace(strange=max(0, found.strange - len(unanswered)))
        self._fail("edit-missed", found.missed, "counted once for each subscriber who was to be told")
        self._fail("edit-late", found.late, "counted once for each subscriber who was to be told")
        self._fail("edit-changed", found.changed, "its strokes are not those that were sent")
        if self._setting.is_own:
            self._fail("edit-strange", found.strange, "edits that were told, and nobody was answered for")
            await self._count_edits(len(unanswered))

    async def _count_edits(self, unanswered: int) -> None:
        """Compare the world's revision with the answers; an edit without an answer may be written, or not."""
        try:
            revision = await asyncio.to_thread(self._setting.revision)
        except BadTarget as error:
            self._fail("no-connection", 1, str(error))
            return
        told = f"revision {revision} after {self._crowd.acknowledged} edits that were acknowledged"
        self._fail("edit-doubled", revision - self._crowd.acknowledged - unanswered, told)
        self._fail("edit-lost", self._crowd.acknowledged - revision, told)

    async def _edit_on(self, name: str, end: float) -> None:
        with suppress(ConnectionError):
            while time.perf_counter() < end and self._left and self._is_there(name):
                sent = self._send(name, time.perf_counter())
                await (asyncio.sleep(POLL_SECONDS) if sent is None else self._crowd.answer(name, sent))

    async def _edit_aside(self, count: int) -> None:
        """Have the first editor edit, one after the other, out of all figures."""
        name = self._editors[0]
        with suppress(TimeoutError):
            async with asyncio.timeout(self._setting.limits.timeout):
                for _ in range(count if self._is_there(name) else 0):
                    sent = self._crowd.edit(name, next(self._strokes))
                    sent.is_aside = True
                    await self._crowd.answer(name, sent)

    def _send(self, name: str, due: float) -> Sent | None:
        """Have an editor send an edit, unless too many wait for their answers."""
        in_flight, exchange = self._crowd.unanswered, Exchange(self._request, due)
        self._left -= 1
        if in_flight >= self._setting.limits.in_flight:
            self._record.due(exchange, True, in_flight)
            self._record.unsent(exchange)
            return None
        sent = self._crowd.edit(name, next(self._strokes), due)
        exchange.sent = max(sent.sent, due)
        self._record.due(exchange, not sent.sent, in_flight + 1)
        return sent

    def _answered(self, sent: Sent) -> None:
        exchange = self._exchange(sent, sent.answered)
        exchange.answer = Answer(sent.status, b"", ())
        if not sent.is_aside:
            if sent.answered - self._counted_at > BYTES_SECONDS:
                self._counted_at = sent.answered
                exchange.received = self._crowd.received - self._record.bytes
            self._record.ended(exchange)
        if sent.status != OK:
            self._fail("nack", 1, sent.refusal)

    def _told(self, sent: Sent) -> None:
        if not sent.is_aside:
            for moment in sent.tellings:
                self.facts.told.add(max(0.0, moment - sent.answered))
            self.facts.last.add(max(0.0, sent.told_at - sent.answered))

    def _exchange(self, sent: Sent, ended: float) -> Exchange:
        return Exchange(self._request, sent.due, max(sent.sent, sent.due), ended)

    def _fail(self, kind: str, count: int, detail: str) -> None:
        now = time.perf_counter()
        if count > 0:
            self._record.fail(Exchange(self._request, now, now, now), kind, detail, count)

    def _is_there(self, name: str) -> bool:
        return name not in self._crowd.lost

    def _drawn(self) -> Iterator[Strokes]:
        """Yield what is dug and filled: as much of either, so that the ground stays as it is."""
        options, chance = self._setting.options, self._setting.options.chance("strokes")
        sides = (options.ground / 2, options.ground * RELIEF / 2, options.ground / 2)
        while True:
            yield [
                {
                    "op": chance.choice(("carve", "fill")),
                    "shape": "sphere",
                    "center": [at + chance.uniform(-side, side) for at, side in zip(options.at, sides, strict=True)],
                    "radius": RADIUS,
                }
                for _ in range(options.strokes)
            ]

    def _looks(self) -> list[Look]:
        """Return where subscribers look: everywhere, or at boxes of `look` voxels on the ground, at LOD 0."""
        options, chance = self._setting.options, self._setting.options.chance("looks")
        if not options.look:
            return [EVERYWHERE]
        side, looks = round(options.look), []
        for _ in range(LOOKS):
            x, z = (round(options.at[axis] + chance.uniform(-0.5, 0.5) * options.ground) for axis in (0, 2))
            low = (x - side // 2, round(options.at[1]) - side // 2, z - side // 2)
            looks.append(Look(low, (low[0] + side, low[1] + side, low[2] + side), 0))
        return looks


class Storm(NamedTuple):
    """A kind of load on a stream. play: what the crowd does once all have joined."""

    summary: str
    play: Callable[[Stage], Awaitable[None]]


async def perform(storm: Storm, setting: Setting, record: Record) -> Facts:
    """Have a storm take place, write it down, and return what there is beside the record.

    Raises BadTarget if not all can join.
    """
    stage = Stage(setting, record)
    try:
        await stage.join()
        gc.freeze()  # what is there now is not looked through again while edits are timed
        record.begun(time.perf_counter())
        await storm.play(stage)
        await stage.end()
    finally:
        gc.unfreeze()
        stage.facts.crowd.close()
    return stage.facts


async def _edit(stage: Stage) -> None:
    await stage.edit(stage.seconds)


async def _reconnect(stage: Stage) -> None:
    for _ in range(stage.cuts):
        await stage.edit(stage.seconds / stage.cuts)
        await stage.cut()


STORMS: Final[Mapping[str, Storm]] = {
    "edit-storm": Storm("editors edit, and subscribers are told", _edit),
    "reconnect-storm": Storm("the same, and again and again all are cut and come back at once", _reconnect),
}
"""Every storm. A new one is one row, and the function that it names."""
