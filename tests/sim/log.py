"""The log of a world as docs/edits/log.md says that it is: what is in it is durable."""

from typing import Any, NamedTuple

from chunkserver.stream import StreamEdit
from tests.sim.terrain import CELLS, LODS, told

Strokes = list[dict[str, Any]]


class Entry(NamedTuple):
    """An edit that is durable."""

    revision: int
    strokes: Strokes
    client: str | None
    seq: int | None

    def edit(self) -> StreamEdit:
        return StreamEdit(self.revision, told(self.strokes), stale_of(self.strokes), CELLS, self.client, self.seq)


def stale_of(strokes: Strokes) -> bytes:
    return told([each for stroke in strokes for each in ranges_of(stroke)])


def ranges_of(stroke: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the chunks that a stroke makes stale: one of LOD 0, and the one of LOD 1 that holds it."""
    at = stroke["at"]
    places = [] if at is None else [(lod, at >> lod) for lod in LODS]
    return [{"lod": lod, "min": [x, 0, 0], "max": [x, 0, 0]} for lod, x in places]


class Outcome(NamedTuple):
    """What became of a draft: an entry; whether it had been written before; whether it is known one by one."""

    revision: int
    strokes: Strokes | None
    duplicate: bool


class Log:
    """One world's log. `entries` keeps what was compacted too: for those who check."""

    def __init__(self, epoch: str) -> None:
        self.epoch = epoch
        self.entries: list[Entry] = []
        self.floor = 0

    @property
    def revision(self) -> int:
        return len(self.entries)

    def mark(self, client: str) -> int | None:
        return max(
            (entry.seq for entry in self.entries if entry.client == client and entry.seq is not None), default=None
        )

    def append(self, client: str | None, seq: int | None, strokes: Strokes) -> Outcome | str:
        """Write an edit, or say what became of it, or why it is refused."""
        own = [entry for entry in self.entries if client is not None and entry.client == client]
        for entry in own:
            if entry.seq == seq and entry.revision > self.floor:
                return Outcome(entry.revision, entry.strokes, True) if entry.strokes == strokes else "another body"
        founded = [entry for entry in own if entry.revision <= self.floor]
        if seq is not None and any(entry.seq is not None and entry.seq >= seq for entry in founded):
            return Outcome(founded[-1].revision, None, True)
        if seq is not None and any(entry.seq is not None and entry.seq > seq for entry in own):
            return "never written"
        self.entries.append(Entry(self.revision + 1, strokes, client, seq))
        return Outcome(self.revision, strokes, False)

    def read(self, after: int, limit: int) -> list[Entry] | None:
        return None if after < self.floor else self.entries[after : after + limit]

    def last(self, lod: int, x: int) -> int:
        """Return the revision of a chunk's last edit."""
        for entry in reversed(self.entries):
            for stroke in entry.strokes:
                if stroke["at"] is not None and stroke["at"] >> lod == x:
                    return entry.revision
        return 0
