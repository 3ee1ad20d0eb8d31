"""A game without a server: a session, its clock, and whatever a test has a server say."""

import json
from typing import Any

from chunkserver_client import ChunkKey, Retry
from chunkserver_client.stream import Region, Session

HOME, AWAY = Region((0, 0, 0), (31, 31, 31)), Region((64, 0, 0), (95, 31, 31))
NEAR, FAR = ChunkKey(0, 0, 0, 0), ChunkKey(0, 2, 0, 0)
STROKES = [{"op": "carve"}]
RANGE = {"lod": 0, "min": [0, 0, 0], "max": [0, 0, 0]}


class Game:
    """A session with its clock, and a server that says what a test wants."""

    def __init__(self, *, revision: int = 10, inflight: int = 64, welcomed: bool = True) -> None:
        self.now = 0.0
        retry = Retry(backoff_seconds=1.0, backoff_seconds_max=8.0)
        self.session = Session("me", [HOME], 32, lambda: self.now, retry, lambda _, high: high)
        if welcomed:
            self.connect(revision=revision, inflight=inflight)

    def connect(self, **members: Any) -> list[Any]:
        self.session.connected()
        self.said()
        return self.welcome(**members)

    def welcome(
        self, epoch: str = "one", revision: int = 10, last_seq: int | None = None, inflight: int = 64
    ) -> list[Any]:
        limits = {"frame_bytes": 65536, "inflight": inflight, "regions": 64}
        return self.hear("welcome", epoch=epoch, revision=str(revision), floor="0", last_seq=last_seq, limits=limits)

    def hear(self, kind: str, **members: Any) -> list[Any]:
        return list(self.session.received(json.dumps({"type": kind, **members})))

    def ack(self, seq: int, revision: int) -> list[Any]:
        return self.hear("ack", seq=seq, revision=str(revision), duplicate=False, stale=[RANGE])

    def edits(self, after: int, revision: int) -> list[Any]:
        some = [{"revision": str(revision), "strokes": STROKES}]
        return self.hear("edits", after=str(after), revision=str(revision), edits=some, stale=[RANGE])

    def said(self) -> list[dict[str, Any]]:
        return [json.loads(frame) for frame in self.session.outgoing()]

    def seqs(self) -> list[int]:
        return [message["seq"] for message in self.said() if message["type"] == "edit"]

    def is_broken(self) -> bool:
        return self.session.is_broken

    def connect_at(self) -> float | None:
        return self.session.connect_at

    def regions(self) -> list[Region]:
        return list(self.session.regions)

    def show(self, *keys: ChunkKey) -> None:
        for key in keys:
            self.session.chunks.add(key)
        for refresh in self.session.chunks.take():
            self.session.chunks.done(refresh, self.session.revision)
