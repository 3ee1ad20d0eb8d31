"""One connection, as a state machine: frames come in, frames and questions to the log go out.

    opening -- hello --> introducing -- introduced --> open          any of them --> closed

It has no socket, clock or log of its own. Whoever has the socket hands over what it reads, sends the outbox's front,
reads no more while `is_paused`, and closes the socket when there is a `closing`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

from chunkserver.stream import answers, closing
from chunkserver.stream.closing import Close
from chunkserver.stream.edit import StreamEdit
from chunkserver.stream.limits import HELLO_SECONDS, INFLIGHT_MAX, REGIONS_MAX, REPLAYED_MAX
from chunkserver.stream.messages import (
    BadMessage,
    FrameTooLarge,
    Hello,
    Message,
    NewEdit,
    Subscribe,
    Unsubscribe,
    read_message,
)
from chunkserver.stream.outbox import Outbox
from chunkserver.stream.ranges import bounded, read_ranges
from chunkserver.stream.reader import Reader, Source
from chunkserver.stream.regions import Regions


class Journal(Protocol):
    """What a connection asks of the log of its world. Each answer comes later, as a call of the connection's method."""

    def introduce(self, connection: "Connection", client: str) -> None:
        """Look up the client's highest seq, and the floor: `introduced`."""

    def submit(self, connection: "Connection", client: str, seq: int, strokes: list[Any]) -> None:
        """Write an edit: `Stream.written`, then; or `repeated`, or `refused`.

        Edits of one client are written in the order in which they are submitted.
        """

    def replay(self, connection: "Connection", after: int) -> None:
        """Read the edits behind a revision, some at once: `replayed`; or `compacted`, if they are below the floor."""


class Room(Source, Protocol):
    """The world that a connection is in."""

    epoch: str

    def joined(self, connection: "Connection", client: str) -> None:
        """Take in a connection that has been introduced, in the place of any other of this client."""

    def left(self, connection: "Connection") -> None:
        """Let go of a connection that is closed."""


class Connection:
    """One connection. Made by `Stream.connect`.

    outbox: what to send. closing: why the connection is to be closed; None as long as it is not.
    """

    def __init__(self, room: Room, journal: Journal, clock: Callable[[], float], wake: Callable[[], None]) -> None:
        self.outbox = Outbox(clock, wake)
        self.closing: Close | None = None
        self.client: str | None = None
        self._room, self._journal, self._clock, self._wake = room, journal, clock, wake
        self._state: Literal["opening", "introducing", "open", "closed"] = "opening"
        self._opened_at = clock()
        self._hello: Hello | None = None
        self._reader: Reader | None = None
        self._inflight: set[int] = set()
        self._seq = -1

    @property
    def is_paused(self) -> bool:
        """Whether nothing more should be read now: too many edits wait for their answers, or too much is unsent."""
        return len(self._inflight) >= INFLIGHT_MAX or not self.outbox.has_room

    def received(self, frame: str | bytes) -> None:
        """Take a frame: text as str, binary as bytes. One that cannot be taken closes the connection."""
        if self._state == "closed":
            return
        try:
            self._take(read_message(frame))
        except FrameTooLarge:
            self.close(closing.TOO_LARGE)
        except BadMessage as error:
            self.close(closing.malformed(error.message))

    def sent(self) -> None:
        """Note that the front of the outbox was sent; that is of no interest if it was closed meanwhile."""
        if self._state == "closed":
            return
        self.outbox.sent()
        if self._reader is not None:
            self._reader.flush()

    def tick(self) -> None:
        """Tell what there is; close the connection if its peer is too slow. To be called every TICK_SECONDS."""
        if self._state == "opening" and self._clock() - self._opened_at > HELLO_SECONDS:
            self.close(closing.NO_HELLO)
        elif self.outbox.is_stuck:
            self.close(closing.TOO_SLOW)
        elif self._reader is not None:
            self._reader.tick()

    def introduced(self, last_seq: int | None, floor: int) -> None:
        """Take what the log knows of the client: welcome it, and go on from where it was."""
        if self._state != "introducing" or self._hello is None:
            return
        hello, revision = self._hello, self._room.recent.end
        self._state = "open"
        self.outbox.put(answers.welcome(self._room.epoch, revision, floor, last_seq))
        resume = revision if hello.resume is None or hello.epoch != self._room.epoch else hello.resume
        is_kept = floor <= resume <= revision and revision - resume <= REPLAYED_MAX
        self._reader = Reader(
            *(self._room, self.outbox, self._clock, lambda after: self._journal.replay(self, after)),
            client=hello.client,
            resume=resume if is_kept else revision,
            regions=hello.regions,
        )
        if not is_kept:
            self._reader.resync(floor, self._room.epoch)
        self._room.joined(self, hello.client)

    def written(self, edit: StreamEdit) -> None:
        """Answer this client's own edit, which is durable now."""
        if self._state == "open" and edit.seq is not None:
            is_first = edit.seq in self._inflight
            self._answer(edit.seq, answers.ack(edit.seq, edit.revision, edit.ranges, duplicate=not is_first))

    def repeated(self, seq: int, revision: int, stale: bytes) -> None:
        """Answer an edit that had been written before. stale: as it was answered then; b"" if that is not known."""
        ranges = bounded(read_ranges(stale)) if stale else None
        if seq in self._inflight:
            self._answer(seq, answers.ack(seq, revision, ranges, duplicate=True))

    def refused(self, seq: int, problem: Mapping[str, Any]) -> None:
        """Answer an edit that is not written. problem: the members of RFC 9457."""
        if seq in self._inflight:
            self._answer(seq, answers.nack(seq, problem))

    def replayed(self, edits: Sequence[StreamEdit], floor: int) -> None:
        """Take edits that were asked for. floor: of the log."""
        if self._reader is not None:
            self._reader.replayed(tuple(edits), floor, self._room.epoch)

    def compacted(self, floor: int) -> None:
        """Take that edits which were asked for are not there one by one any more."""
        if self._reader is not None:
            self._reader.resync(floor, self._room.epoch)

    def overtaken(self, kept: int) -> None:
        """Go on without the edits up to `kept`, which are recent no longer, if they are to be told yet."""
        if self._reader is not None and self._reader.scanned < kept:
            self._reader.skip()

    def close(self, why: Close) -> None:
        """End the connection. What is not sent yet is not sent any more."""
        if self._state != "closed":
            self._state, self.closing, self._reader = "closed", why, None
            self.outbox.clear()
            self._inflight.clear()
            self._room.left(self)
            self._wake()

    def _take(self, message: Message) -> None:
        match message:
            case Hello() if self._state == "opening":
                self._state, self._hello, self.client = "introducing", message, message.client
                self._journal.introduce(self, message.client)
            case NewEdit(seq, strokes) if self._state == "open" and self.client is not None:
                self._submit(self.client, seq, strokes)
            case Subscribe(regions) if self._reader is not None:
                self._ask(self._reader, self._reader.wanted | regions)
            case Unsubscribe(regions) if self._reader is not None:
                self._ask(self._reader, self._reader.wanted - regions)
            case _:
                name = type(message).__name__.removeprefix("New").lower()
                self.close(closing.out_of_order(f"{name} may not come while the connection is {self._state}"))

    def _submit(self, client: str, seq: int, strokes: list[Any]) -> None:
        if seq <= self._seq:
            self.close(closing.out_of_order(f"seq {seq} follows {self._seq}"))
            return
        self._seq = seq
        self._inflight.add(seq)
        self._journal.submit(self, client, seq, strokes)

    def _ask(self, reader: Reader, regions: Regions) -> None:
        if len(regions) > REGIONS_MAX:
            self.close(closing.malformed(f"{len(regions)} regions; the limit is {REGIONS_MAX}"))
        else:
            reader.ask(regions)

    def _answer(self, seq: int, frame: bytes) -> None:
        self._inflight.discard(seq)
        self.outbox.put(frame)
        if len(self._inflight) == INFLIGHT_MAX - 1:
            self._wake()
