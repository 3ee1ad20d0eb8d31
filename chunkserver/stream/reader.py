"""How far one connection has got in the edits of its world, and what it is told next.

    told <= scanned <= the world's revision

Edits up to `scanned` were looked at. The peer knows that it has everything up to `told`: that is where the next message
of edits begins. `missed` are the chunks of edits between the two that are not sent, because the peer was too slow.
"""

from collections.abc import Callable
from typing import Protocol

from chunkserver.stream import answers
from chunkserver.stream.edit import StreamEdit, StreamEdits, edits_in
from chunkserver.stream.limits import BEHIND_SECONDS, PROGRESS_SECONDS, REPLAYED_MAX
from chunkserver.stream.outbox import Outbox
from chunkserver.stream.ranges import Range, bounded
from chunkserver.stream.recent import Recent
from chunkserver.stream.regions import Regions


class Source(Protocol):
    """Where edits come from; what many are told is made once."""

    recent: Recent

    def matching(self, after: int, regions: Regions) -> tuple[StreamEdits, StreamEdits] | None:
        """Return the next recent edits, and those of them in the regions; None if some are not kept any more."""

    def messages(self, after: int, edits: StreamEdits, revision: int) -> list[tuple[bytes, int]]:
        """Return what `answers.edits` does."""


class Reader:
    """One connection's place in the edits.

    client: who it is: its own edits are answered, not told.
    resume: the revision up to which it has everything. regions: where it looks.
    replay: called with a revision when the edits behind it are wanted from the log: `replayed` takes them.
    """

    def __init__(
        self,
        source: Source,
        outbox: Outbox,
        clock: Callable[[], float],
        replay: Callable[[int], None],
        *,
        client: str,
        resume: int,
        regions: Regions,
    ) -> None:
        self.regions = regions
        self.told = self.scanned = resume
        self._source, self._outbox, self._clock, self._replay = source, outbox, clock, replay
        self._client = client
        self._welcomed = source.recent.end
        self._answered = resume
        self._missed: tuple[Range, ...] | None = None
        self._wanted, self._asked, self._obeyed = regions, 0, 0
        self._is_asking = False
        self._replayed_count = 0
        self._told_at = clock()
        self._behind_since: float | None = None

    @property
    def is_at_end(self) -> bool:
        """Whether the peer was sent everything there is."""
        return self.scanned == self._source.recent.end and self._missed is None

    @property
    def wanted(self) -> Regions:
        """The regions that were asked for last, which may not be in force yet."""
        return self._wanted

    def ask(self, regions: Regions) -> None:
        """Change the regions as soon as everything up to now is told for those before."""
        self._wanted = regions
        self._asked += 1
        self.flush()

    def flush(self) -> None:
        """Put as much into the outbox as there is, and as there is room for."""
        if self._behind_since is not None and self._clock() - self._behind_since > BEHIND_SECONDS:
            self.skip()
        while self._outbox.has_room and not self.is_at_end:
            if not self._go_on():
                break
        is_late = not self.is_at_end and self.scanned >= self._source.recent.start
        self._behind_since = (self._behind_since or self._clock()) if is_late else None
        if self.is_at_end and self._outbox.has_room and self._asked > self._obeyed:
            self.regions, self._obeyed = self._wanted, self._asked
            self._put(answers.progress(self.scanned, self._obeyed), self.scanned)

    def tick(self) -> None:
        """Flush; and if nothing was told for a while, how far everything is told."""
        self.flush()
        is_due = self._clock() - self._told_at >= PROGRESS_SECONDS
        if is_due and self._outbox.has_room:
            self._put(answers.progress(self.scanned, self._obeyed), self.scanned)

    def replayed(self, edits: StreamEdits, floor: int, epoch: str) -> None:
        """Take the next edits of the log, without a hole. Resync if they are more than one connection may have."""
        self._is_asking = False
        self._replayed_count += len(edits)
        if self._replayed_count > REPLAYED_MAX:
            self.resync(floor, epoch)
        elif edits:
            assert edits[0].revision == self.scanned + 1, f"revision {edits[0].revision} follows {self.scanned}"
            self._tell(edits, edits_in(edits, self.regions))
        self.flush()

    def resync(self, floor: int, epoch: str) -> None:
        """Go on from the world's revision; the peer is told that it has missed it knows not what."""
        self._is_asking = False
        self.scanned = self._source.recent.end
        self._put(answers.resync(floor, self.scanned, epoch), self.scanned)

    def skip(self) -> None:
        """Go on from the world's revision; the peer is told which chunks the edits between have made stale.

        That stands for answers to its own edits, too: it is said even if there are no such chunks where it looks.
        """
        ranges, is_owed = list(self._missed or ()), self._missed is not None
        while (found := self._source.matching(self.scanned, self.regions)) and found[0]:
            some, inside = found
            owed = [edit for edit in some if edit.client == self._client and not self._is_answered(edit)]
            others = [edit for edit in inside if edit.client != self._client]
            ranges += [each for edit in (*owed, *others) for each in edit.ranges]
            is_owed |= bool(owed)
            self.scanned = some[-1].revision
        self._missed = bounded(ranges) if ranges or is_owed else None

    def _go_on(self) -> bool:
        """Tell the next of what there is. Return whether it is worth going on."""
        if self._missed is not None:
            self._put(answers.stale(self._missed, self.scanned), self.scanned)
            self._missed = None
            return True
        found = self._source.matching(self.scanned, self.regions)
        if found is None:
            if not self._is_asking:
                self._is_asking = True
                self._replay(self.scanned)
            return False
        self._tell(*found)
        return True

    def _tell(self, some: StreamEdits, inside: StreamEdits) -> None:
        """Tell the next edits, of which some are in the regions: own ones by their answers, before the others.

        What the outbox has no room for is left for another time.
        """
        revision = some[-1].revision
        for edit in some if self.scanned < self._welcomed else ():
            if edit.client == self._client and edit.seq is not None and not self._is_answered(edit):
                if not self._outbox.has_room:
                    return
                self._outbox.put(answers.ack(edit.seq, edit.revision, edit.ranges, duplicate=True))
                self._answered = edit.revision
        if any(edit.client == self._client for edit in inside):
            inside = tuple(edit for edit in inside if edit.client != self._client)
        for message, reached in self._source.messages(self.told, inside, revision) if inside else ():
            if not self._outbox.has_room:
                return
            self.scanned = reached
            self._put(message, reached)
        self.scanned = revision

    def _is_answered(self, edit: StreamEdit) -> bool:
        """Whether an edit is this client's own, and was answered on this connection: when it was written, or since."""
        return edit.client == self._client and not self._answered < edit.revision <= self._welcomed

    def _put(self, message: bytes, revision: int) -> None:
        self._outbox.put(message)
        self.told = revision
        self._told_at = self._clock()
