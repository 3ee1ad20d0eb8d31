"""One editor of a crowd: its edits wait for room on the connection, for their answers, or for a connection."""

from collections import deque
from collections.abc import Mapping
from typing import Any

from chunkserver_loadtest.peer import Peer
from chunkserver_loadtest.tellings import Sent


class Editor:
    """Sends edits in the order of their seqs, on one connection after the other, until each is answered."""

    def __init__(self) -> None:
        self._edits: dict[int, Sent] = {}
        self._unsent: deque[int] = deque()
        self._peer: Peer | None = None
        self._seq = self._room = 0

    def __len__(self) -> int:
        """Return how many edits have no answer."""
        return len(self._edits)

    def add(self, sent: Sent) -> None:
        """Take an edit, which is sent as soon as there is room for it."""
        self._seq += 1
        self._edits[self._seq] = sent
        self._unsent.append(self._seq)

    def welcomed(self, peer: Peer, welcome: Mapping[str, Any]) -> None:
        """Go on, on a connection that is welcome: what was not answered is sent again."""
        self._peer, self._room = peer, int(welcome["limits"]["inflight"])
        self._seq = max(self._seq, int(welcome["last_seq"] or 0))
        self._unsent = deque(sorted(self._edits))

    def lost(self) -> None:
        """Have no connection."""
        self._peer = None

    def flush(self, moment: float) -> None:
        """Send what there is room for."""
        while self._peer is not None and self._unsent and len(self._edits) - len(self._unsent) < self._room:
            seq = self._unsent.popleft()
            sent = self._edits[seq]
            sent.sent = sent.sent or moment
            self._peer.send("edit", seq=seq, strokes=sent.strokes)

    def answered(self, seq: int) -> Sent | None:
        """Return the edit that is answered, and forget it; None if nobody waits for this answer."""
        found = self._edits.pop(seq, None)
        if found is not None and seq in self._unsent:
            self._unsent.remove(seq)
        return found

    def forget(self) -> list[Sent]:
        """Return all edits that were not answered, and forget them."""
        edits, self._edits = self._edits, {}
        self._unsent.clear()
        return list(edits.values())
