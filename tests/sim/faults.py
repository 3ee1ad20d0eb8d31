"""Faults that break one guarantee each, most of them of the server: what the checkers are there to find."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import pytest

from chunkserver.stream import StreamEdit, answers, connection, reader
from chunkserver.stream.connection import Connection
from chunkserver.stream.reader import Reader
from chunkserver_client.edits import ChunkRange
from chunkserver_client.stream.chunks import Chunks

Edits = tuple[StreamEdit, ...]
Fault = Callable[[pytest.MonkeyPatch], None]

_edits = answers.edits


def swapped(patch: pytest.MonkeyPatch) -> None:
    """Tell edits in the wrong order."""
    patch.setattr(answers, "edits", lambda after, some, revision: _edits(after, some[::-1], revision))


def doubled(patch: pytest.MonkeyPatch) -> None:
    """Tell the first edit of a message twice."""
    patch.setattr(answers, "edits", lambda after, some, revision: _edits(after, (some[0], *some), revision))


def left_out(patch: pytest.MonkeyPatch) -> None:
    """Leave out the first of several edits."""
    patch.setattr(answers, "edits", lambda after, some, revision: _edits(after, some[1:] or some, revision))


def halved(patch: pytest.MonkeyPatch) -> None:
    """Tell the edit now and its chunks never."""
    patch.setattr(StreamEdit, "pieces", ())


def ahead(patch: pytest.MonkeyPatch) -> None:
    """Go on one edit behind where the client was."""

    def late(source: Any, *rest: Any, resume: int, **others: Any) -> Reader:
        return Reader(source, *rest, resume=min(resume + 1, source.recent.end), **others)

    patch.setattr(connection, "Reader", late)


HASTY_SECONDS = 0.05


def hasty(patch: pytest.MonkeyPatch) -> None:
    """Say that everything was told, whatever was."""

    def tick(self: Reader) -> None:
        if self._clock() - self._told_at >= HASTY_SECONDS:
            self._put(answers.progress(self._source.recent.end, self._obeyed), self.told)
        self.flush()

    patch.setattr(Reader, "tick", tick)


def mute(patch: pytest.MonkeyPatch) -> None:
    """Say nothing when there is nothing to tell."""
    patch.setattr(Reader, "tick", Reader.flush)


def early(patch: pytest.MonkeyPatch) -> None:
    """Acknowledge what is not written yet."""
    submit = Connection._submit

    def hurry(self: Connection, client: str, seq: int, strokes: list[Any]) -> None:
        submit(self, client, seq, strokes)
        self.outbox.put(answers.ack(seq, self._room.recent.end + 1, (), duplicate=False))

    patch.setattr(Connection, "_submit", hurry)


def careless(patch: pytest.MonkeyPatch) -> None:
    """Leave out, for a reader that is slow, which chunks are stale."""
    patch.setattr(reader, "bounded", lambda ranges: tuple(ranges)[1:])


def stubborn(patch: pytest.MonkeyPatch) -> None:
    """Agree to other regions, and go on with those before."""
    ask = Reader.ask
    patch.setattr(Reader, "ask", lambda self, _: ask(self, self.regions))


def shortsighted(patch: pytest.MonkeyPatch) -> None:
    """Be a client that overlooks chunks of coarser levels."""
    changed = Chunks.changed

    def overlook(self: Chunks, ranges: Iterable[ChunkRange], revision: int) -> None:
        changed(self, [each for each in ranges if each.lod == 0], revision)

    patch.setattr(Chunks, "changed", overlook)


FAULTS: Mapping[Fault, str] = {
    swapped: "ordered",
    doubled: "unique",
    left_out: "reliable",
    careless: "reliable",
    halved: "atomic",
    ahead: "resumable",
    hasty: "bookmarkable",
    mute: "bookmarkable",
    early: "durable",
    stubborn: "reliable",
    shortsighted: "converged",
}
"""Which guarantee each of them breaks."""
