"""One transaction that appends edits: which of them are new, and what becomes of those that are not."""

from typing import Final

import apsw

from chunkserver.errors import BadParameter, ChunkError, StoreFull, WorldGone
from chunkserver.store.draft import Draft, Outcome
from chunkserver.store.tail import Tail, mark_of, tail_of

KEYS_MAX: Final = 100_000
"""Of a world: the newest are kept, each with its answer."""
CLIENTS_MAX: Final = 100_000
"""Of a world. None is ever forgotten, or what it sends again would be written twice: one more is refused."""


class Appending:
    """The drafts of one call, one after the other. Each is looked at as a whole before anything of it is written."""

    def __init__(self, connection: apsw.Connection) -> None:
        self._connection = connection
        self._tails: dict[str, Tail] = {}

    def outcome(self, draft: Draft) -> Outcome | ChunkError:
        """Return what became of a draft."""
        try:
            tail = self._tails.get(draft.epoch) or tail_of(self._connection, draft.epoch)
            self._tails[draft.epoch] = tail
            return self._known_key(tail, draft) or self._sent_before(tail, draft) or self._written(tail, draft)
        except (BadParameter, StoreFull, WorldGone) as refusal:
            return refusal

    def _known_key(self, tail: Tail, draft: Draft) -> Outcome | None:
        if draft.key is None:
            return None
        query = (
            "SELECT keys.revision, coalesce(keys.stale, edits.stale), keys.digest FROM keys"
            " LEFT JOIN edits USING (world, revision) WHERE keys.world = ? AND key = ?"
        )
        for revision, stale, digest in self._connection.execute(query, (tail.world, draft.key)):
            _check_body(draft, digest, f"key {draft.key!r}")
            return Outcome(revision, stale, duplicate=True)
        return None

    def _sent_before(self, tail: Tail, draft: Draft) -> Outcome | None:
        """Return the first answer to a seq, while its edit is there, though below the floor; else what is known."""
        if draft.client is None or draft.seq is None:
            return None
        where = (tail.world, draft.client, draft.seq)
        query = "SELECT revision, stale, digest FROM edits WHERE world = ? AND client = ? AND seq = ?"
        for revision, stale, digest in self._connection.execute(query, where):
            _check_body(draft, digest, f"seq {draft.seq} of client {draft.client!r}")
            return Outcome(revision, stale, duplicate=True)
        mark = mark_of(self._connection, tail.world, draft.client)
        if mark is None or draft.seq > mark:
            return None
        query = "SELECT revision FROM clients WHERE world = ? AND client = ? AND seq >= ?"
        for (revision,) in self._connection.execute(query, where):
            return Outcome(revision, b"", duplicate=True)
        message = f"seq {draft.seq} of client {draft.client!r} was never written, and {mark} was: take a higher one"
        raise BadParameter(message, client=draft.client, seq=draft.seq, mark=mark)

    def _written(self, tail: Tail, draft: Draft) -> Outcome:
        if draft.client is not None:
            self._introduce(tail, draft.client)
        tail.revision += 1
        self._connection.execute(
            "INSERT INTO edits (world, revision, client, seq, digest, strokes, stale) VALUES (?, ?, ?, ?, ?, ?, ?)",
            (tail.world, tail.revision, draft.client, draft.seq, draft.digest, draft.strokes, draft.stale),
        )
        if draft.key is not None:
            self._keep_key(tail, draft)
        return Outcome(tail.revision, draft.stale)

    def _introduce(self, tail: Tail, client: str) -> None:
        found = self._connection.execute(
            "SELECT 1 FROM clients WHERE world = ? AND client = ?", (tail.world, client)
        ).get
        if found:
            return
        if tail.clients >= CLIENTS_MAX:
            message = f"{tail.clients} clients have edited this world, which is the limit"
            raise StoreFull(message, clients_max=CLIENTS_MAX)
        tail.clients += 1
        self._connection.execute("INSERT INTO clients (world, client) VALUES (?, ?)", (tail.world, client))
        self._connection.execute("UPDATE logs SET clients = ? WHERE world = ?", (tail.clients, tail.world))

    def _keep_key(self, tail: Tail, draft: Draft) -> None:
        if tail.keys < KEYS_MAX:
            tail.keys += 1
            self._connection.execute("UPDATE logs SET keys = ? WHERE world = ?", (tail.keys, tail.world))
        else:
            oldest = "(SELECT min(revision) FROM keys WHERE world = :world)"
            forget = f"DELETE FROM keys WHERE world = :world AND revision = {oldest}"
            self._connection.execute(forget, {"world": tail.world})
        self._connection.execute(
            "INSERT INTO keys (world, revision, key, digest) VALUES (?, ?, ?, ?)",
            (tail.world, tail.revision, draft.key, draft.digest),
        )


def _check_body(draft: Draft, digest: bytes, name: str) -> None:
    if draft.digest != digest:
        raise BadParameter(f"{name} was used for another body", client=draft.client, seq=draft.seq, key=draft.key)
