"""A session of one player in one world, as a state machine: it lasts over any number of connections.

    waiting -- connected --> opening -- welcome --> live -- lost --> waiting ...          any of them --> ended

It knows no socket and no clock. Whoever has the socket connects when `connect_at` has come, hands over what it reads,
sends what `outgoing` returns, and closes the socket when `is_broken`. docs/wire/edit_v1.md is the protocol.
"""

import random
from collections.abc import Callable, Iterable, Sequence
from typing import Final, Literal, NamedTuple

from chunkserver_client.errors import BadAnswer
from chunkserver_client.retry import EXPONENT_MAX, Retry
from chunkserver_client.stream import messages
from chunkserver_client.stream.chunks import Chunks
from chunkserver_client.stream.messages import (
    Ack,
    Edits,
    Message,
    Nack,
    Progress,
    Resync,
    Stale,
    Stroke,
    Welcome,
    read_message,
)
from chunkserver_client.stream.places import Region
from chunkserver_client.stream.unanswered import Unanswered

SILENCE_SECONDS: Final = 5.0
"""The server says something at least once a second: a connection that is silent for so long is dead."""
FINAL_CODES: Final = frozenset({1009, 4400, 4401, 4403, 4404, 4409, 4412, 4422})
"""Codes after which another connection would end in the same way."""


class StartOver(NamedTuple):
    """Another world has this id, or its history was replaced: nothing that was known of it holds.

    lost: seqs of the edits that nobody answers any more.
    """

    epoch: str
    revision: int
    lost: tuple[int, ...]


class Ended(NamedTuple):
    """The session is over: the server closed the connection with a code that says so. lost: seqs without an answer."""

    code: int
    lost: tuple[int, ...]


Event = Message | StartOver | Ended


class Session:
    """One session.

    client: who this is: 1 to 128 visible ASCII characters, which nobody else in the world has. regions: where it looks.
    cells: of a chunk's side. retry: how long to wait between connections: `backoff_seconds` and `backoff_seconds_max`.
    clock: seconds. jitter: as `random.uniform`.

    epoch: of the world; None before the first welcome. revision: everything up to it is known.
    chunks: what the game has, and what of it is out of date.
    connect_at: when to connect; None if there is a connection, or the session is over.
    """

    def __init__(
        self,
        client: str,
        regions: Iterable[Region],
        cells: int,
        clock: Callable[[], float],
        retry: Retry | None = None,
        jitter: Callable[[float, float], float] = random.uniform,
    ) -> None:
        self.client = client
        self.epoch: str | None = None
        self.revision = 0
        self.chunks = Chunks()
        self.connect_at: float | None = clock()
        self._state: Literal["waiting", "opening", "live", "ended"] = "waiting"
        self._regions = _few(dict.fromkeys(regions))
        self._cells = cells
        self._clock, self._retry, self._jitter = clock, retry or Retry(), jitter
        self._unanswered = Unanswered()
        self._outgoing: list[str | bytes] = []
        self._seq = 0
        self._inflight_max = 0
        self._in_force = set(self._regions)
        self._told = dict(self._regions)
        self._asked: list[tuple[Region, ...]] = []
        self._obeyed = 0
        self._failures = 0
        self._heard_at = clock()
        self._is_broken = False

    @property
    def is_live(self) -> bool:
        """Whether the server has welcomed this connection."""
        return self._state == "live"

    @property
    def is_broken(self) -> bool:
        """Whether the connection is of no use any more: close it, and call `lost`."""
        is_silent = self._state in ("opening", "live") and self._clock() - self._heard_at > SILENCE_SECONDS
        return self._is_broken or is_silent

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions that are known to be in force."""
        return tuple(region for region in self._regions if region in self._in_force)

    @property
    def are_regions_in_force(self) -> bool:
        """Whether every region that was asked for is in force."""
        return self.is_live and not self._asked and self._regions.keys() == self._told.keys()

    @property
    def unanswered(self) -> int:
        """How many edits wait for their answers."""
        return len(self._unanswered)

    def edit(self, strokes: Sequence[Stroke]) -> int:
        """Have an edit sent, and sent again until it is answered; return its seq, which the answer has.

        Raises `ValueError` before the first welcome, after the end, and for what is too long for a frame;
        `OverflowError` if too many edits wait.
        """
        if self.epoch is None or self._state == "ended":
            raise ValueError(f"the session is {self._state}: edits come after the first welcome")
        frame = messages.edit(self._seq + 1, strokes)
        self._unanswered.add(self._seq + 1, frame)
        self._seq += 1
        return self._seq

    def subscribe(self, *regions: Region) -> None:
        """Look at these regions too. Chunks in them that the game has are fetched again when that is in force.

        What changes while there is no connection is in the next hello; what changes while the server has not obeyed yet
        is asked for at once when it has. So two requests are under way at most, however often a game looks elsewhere.

        Raises `ValueError` for what is no region, and for more than REGIONS_MAX of them, and changes nothing then.
        """
        self._regions = _few(self._regions | dict.fromkeys(region.check() for region in regions))

    def unsubscribe(self, *regions: Region) -> None:
        """Look at these regions no more."""
        for region in regions:
            self._regions.pop(region, None)

    def connected(self) -> None:
        """Begin on a new connection."""
        self.connect_at, self._heard_at, self._is_broken = None, self._clock(), False
        self._state = "opening"
        resume = None if self.epoch is None else self.revision
        self._outgoing = [messages.hello(self.client, self.epoch, resume, self._regions)]
        self._told = dict(self._regions)
        self._asked, self._obeyed = [tuple(self._told.keys() - self._in_force)], -1
        self._in_force.intersection_update(self._told)

    def received(self, frame: str | bytes) -> list[Event]:
        """Take a frame; return what the game should know. What cannot be breaks the connection."""
        self._heard_at = self._clock()
        try:
            message = read_message(frame)
            if message is None or self._is_broken:
                return []
            events = self._take(message)
            self._failures = self._failures if isinstance(message, Welcome) else 0
            return events
        except BadAnswer:
            self._is_broken = True
            return []

    def lost(self, code: int | None = None) -> list[Event]:
        """Note that the connection is closed, or could not be made.

        code: of the closing frame, if there was one; 4000 + the HTTP status if the upgrade was answered otherwise.
        """
        if code in FINAL_CODES:
            self._state, self.connect_at = "ended", None
            return [Ended(code, self._unanswered.clear())]
        longest = self._retry.backoff_seconds * 2.0 ** min(self._failures, EXPONENT_MAX)
        self._failures += 1
        self._state, self._outgoing = "waiting", []
        self.connect_at = self._clock() + self._jitter(0.0, min(longest, self._retry.backoff_seconds_max))
        return []

    def outgoing(self) -> list[str | bytes]:
        """Return what to send now, in order: text as str, binary as bytes."""
        if self._state == "live":
            self._outgoing += self._asks()
            self._outgoing += self._unanswered.to_send(self._inflight_max)
        frames, self._outgoing = self._outgoing, []
        return frames

    def _asks(self) -> list[str | bytes]:
        """Return the requests for other regions, if those before are in force. First what goes: there is room then."""
        if self._asked:
            return []
        gone = tuple(region for region in self._told if region not in self._regions)
        new = tuple(region for region in self._regions if region not in self._told)
        self._told = dict(self._regions)
        self._in_force.difference_update(gone)
        wanted = [(False, gone), (True, new)]
        self._asked = [new if added else () for added, regions in wanted if regions]
        return [messages.regions_changed(added=added, regions=regions) for added, regions in wanted if regions]

    def _take(self, message: Message) -> list[Event]:
        if isinstance(message, Welcome) is self.is_live:
            raise BadAnswer(f"{type(message).__name__} came, and the session is {self._state}")
        match message:
            case Welcome():
                return self._welcomed(message)
            case Ack(seq, revision, _, stale) if seq in self._unanswered:
                self._unanswered.answered(seq)
                self.chunks.changed(stale or (), revision)
            case Nack(seq) if seq in self._unanswered:
                self._unanswered.answered(seq)
            case Ack() | Nack():
                return []
            case Edits():
                self._advance(message.revision, message.after)
                self.chunks.changed(message.stale, message.revision)
            case Stale():
                self._advance(message.revision)
                self.chunks.changed(message.stale, message.revision)
            case Resync():
                self._advance(message.revision)
                self.chunks.outdate(lambda _: True, message.revision)
            case Progress(revision, asked):
                is_news = revision > self.revision or asked > self._obeyed
                self._advance(revision)
                self._obey(asked)
                return [message] if is_news else []
        return [message]

    def _welcomed(self, welcome: Welcome) -> list[Event]:
        events: list[Event] = [welcome]
        if welcome.epoch != self.epoch:
            if self.epoch is not None:
                events = [StartOver(welcome.epoch, welcome.revision, self._unanswered.clear()), welcome]
                self.chunks.clear()
            self.epoch, self.revision = welcome.epoch, welcome.revision
            self.chunks.outdate(lambda _: True, self.revision)
        self._seq = max(self._seq, welcome.last_seq or 0)
        self._state, self._inflight_max = "live", welcome.inflight
        self._unanswered.resend()
        self._obey(0)
        return events

    def _advance(self, revision: int, after: int | None = None) -> None:
        """Go on to a revision. Raises `BadAnswer` if what lies between was not told."""
        if revision < self.revision or after not in (None, self.revision):
            raise BadAnswer(f"edits of ({after}, {revision}] came, and everything up to {self.revision} is known")
        self.revision = revision

    def _obey(self, asked: int) -> None:
        """Note how many requests for regions are in force. Until then edits there may have been missed."""
        count = asked - self._obeyed
        if not 0 <= count <= len(self._asked):
            raise BadAnswer(f"{asked} requests for regions are in force; there were {self._obeyed + len(self._asked)}")
        new = [region for added in self._asked[:count] for region in added]
        self._asked, self._obeyed = self._asked[count:], asked
        self._in_force.update(new)
        if new:
            self.chunks.outdate(lambda key: any(each.holds(key, self._cells) for each in new), self.revision)


def _few(regions: dict[Region, None]) -> dict[Region, None]:
    """Return regions. Raises `ValueError` if they are more than a connection may have."""
    if len(regions) > messages.REGIONS_MAX:
        raise ValueError(f"{len(regions)} regions: a session looks at {messages.REGIONS_MAX} at most")
    return regions
