"""Edits, connections and a journal for tests that have no world."""

import json
from typing import Any

from chunkserver.stream import Connection, Stream, StreamEdit

CELLS = 32
EVERYWHERE = {"min": [-(1 << 40)] * 3, "max": [1 << 40] * 3}


def stale_at(*places: int, lod: int = 0) -> bytes:
    """Return the ranges of single chunks along x."""
    return json.dumps([{"lod": lod, "min": [x, 0, 0], "max": [x, 0, 0]} for x in places]).encode()


def edit_of(
    revision: int,
    strokes: bytes = b"[{}]",
    stale: bytes | None = None,
    client: str | None = None,
    seq: int | None = None,
) -> StreamEdit:
    """Return an edit of chunk 0."""
    return StreamEdit(revision, strokes, stale_at(0) if stale is None else stale, CELLS, client, seq)


class Journal:
    """Notes what is asked of it."""

    def __init__(self) -> None:
        self.introductions: list[tuple[Connection, str]] = []
        self.submitted: list[tuple[Connection, str, int, list[Any]]] = []
        self.replays: list[tuple[Connection, int]] = []

    def introduce(self, connection: Connection, client: str) -> None:
        self.introductions.append((connection, client))

    def submit(self, connection: Connection, client: str, seq: int, strokes: list[Any]) -> None:
        self.submitted.append((connection, client, seq, strokes))

    def replay(self, connection: Connection, after: int) -> None:
        self.replays.append((connection, after))


class World:
    """A stream, its journal and its clock. now: seconds."""

    def __init__(self, revision: int = 0) -> None:
        self.now = 100.0
        self.wakes = 0
        self.journal = Journal()
        self.stream = Stream("an-epoch", revision, self.journal, lambda: self.now)

    def wake(self) -> None:
        self.wakes += 1

    def connect(self) -> Connection:
        return self.stream.connect(self.wake)

    def welcomed(
        self,
        client: str = "a",
        resume: int | None = None,
        regions: Any = (EVERYWHERE,),
        last_seq: int | None = None,
        floor: int = 0,
    ) -> Connection:
        """Return a connection that was introduced; its welcome was sent."""
        connection = self.connect()
        connection.received(hello(client, resume, regions))
        connection.introduced(last_seq, floor)
        assert taken(connection, 1)[0]["type"] == "welcome"
        return connection

    def written(self, count: int = 1, **members: Any) -> None:
        """Write some edits."""
        for _ in range(count):
            self.stream.written(edit_of(self.stream.recent.end + 1, **members))

    def tick(self, seconds: float = 0.02) -> None:
        self.now += seconds
        self.stream.tick()


def hello(client: str = "a", resume: int | None = None, regions: Any = (EVERYWHERE,), epoch: str = "an-epoch") -> str:
    told = None if resume is None else str(resume)
    return json.dumps({"type": "hello", "client": client, "epoch": epoch, "resume": told, "regions": list(regions)})


def new_edit(seq: int) -> str:
    return json.dumps({"type": "edit", "seq": seq, "strokes": [{"op": "carve"}]})


def taken(connection: Connection, count: int = 1 << 30) -> list[dict[str, Any]]:
    """Take what waits to be sent; return the messages."""
    messages: list[dict[str, Any]] = []
    while len(messages) < count and (frame := connection.outbox.front()) is not None:
        messages.append(json.loads(frame))
        connection.sent()
    return messages
