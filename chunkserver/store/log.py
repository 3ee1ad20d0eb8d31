"""The log of edits: what was acknowledged, in order. It is the truth; what is made of it can be made again.

    revision    1 2 3 ... floor   | floor + 1 ... revision
                    foundation    | edits, each as it was sent

A world is named by its epoch. Strokes and what they make stale are bytes that mean nothing here.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Final, NamedTuple

import apsw

from chunkserver.errors import BadParameter, ChunkError, StoreFull, WorldGone
from chunkserver.store.sqlite import Database

KEYS_MAX: Final = 100_000
"""Of a world: the newest are kept."""
CLIENTS_MAX: Final = 100_000
"""Of a world. None is ever forgotten, or what it sends again would be written twice: one more is refused."""
EDIT_BYTES_MAX: Final = 16 << 20
"""Of an edit: its strokes, what they make stale, and its digest."""
NAME_CHARS_MAX: Final = 128
"""Of a key, and of a client's name."""
SEQ_MAX: Final = (1 << 53) - 1
"""The largest integer that JSON carries everywhere."""
READ_EDITS_MAX: Final = 10_000
READ_BYTES_MAX: Final = 16 << 20
"""Of one `read`; an edit that is larger comes alone."""

assert READ_BYTES_MAX >= EDIT_BYTES_MAX


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """An edit that is to be written.

    epoch: of its world.
    digest: of the request's body. Who sends a key or a seq again sends the same body.
    strokes: what is kept.
    stale: what is answered, beside the revision; and again to who sends it again.
    client, seq: who sends it, and the client's own number for it, which rises; or neither.
    key: another name for it, unique in its world.

    Raises `BadParameter` for what is too long, and for a seq without a client.
    """

    epoch: str
    digest: bytes
    strokes: bytes
    stale: bytes
    client: str | None = None
    seq: int | None = None
    key: str | None = None

    def __post_init__(self) -> None:
        if (self.client is None) is not (self.seq is None):
            raise BadParameter(f"client is {self.client!r} and seq is {self.seq}: both are needed, or neither")
        if self.seq is not None and not 0 <= self.seq <= SEQ_MAX:
            raise BadParameter(f"seq is {self.seq}; it lies in [0, {SEQ_MAX}]", seq=self.seq)
        for name, value in (("client", self.client), ("key", self.key)):
            if value is not None and not 1 <= len(value) <= NAME_CHARS_MAX:
                message = f"{name} has {len(value)} characters; it has 1 to {NAME_CHARS_MAX}"
                raise BadParameter(message, **{name: value[:NAME_CHARS_MAX]})
        if self.weight > EDIT_BYTES_MAX:
            raise BadParameter(f"the edit has {self.weight} bytes; the limit is {EDIT_BYTES_MAX}", bytes=self.weight)

    @property
    def weight(self) -> int:
        """How many bytes it is."""
        return len(self.strokes) + len(self.stale) + len(self.digest)


class Outcome(NamedTuple):
    """What was written.

    revision: of the edit.
    stale: as its draft said when it was written; b"" if that is not known any more.
    duplicate: it had been written before. If its edit is in the foundation and had no key, the revision is that of the
        client's last edit there: not its own perhaps, but no later than the floor.
    """

    revision: int
    stale: bytes
    duplicate: bool = False


class Edit(NamedTuple):
    """An edit as it was written."""

    revision: int
    strokes: bytes
    stale: bytes
    client: str | None
    seq: int | None


class Foundation(NamedTuple):
    """What all edits up to `floor` have made, in named parts. Floor 0: there is none."""

    floor: int
    parts: Mapping[bytes, bytes]


class EditLog:
    """The edits of all worlds of a database. Safe in any thread; no thread but the `Writer`'s should append.

    Another store can stand in its place if it has these methods, and promises this:

    - When `append` or `compact` returns, what it says is durable. When it raises, nothing of it is there, neither now
      nor after a restart; but for a commit of which nobody can say how it ended: then all or nothing of it is there
      after the restart, and nothing more is written before.
    - All drafts of one call are one transaction. Revisions of a world are 1, 2, 3 ... without a hole, in the order of
      the drafts; readers see them in that order and never one without those before it. (A counter of the world that
      is raised in the same transaction does that. A sequence of the database does not: its order is not that of the
      commits.)
    - A world has a seq of a client once, and a key once, whichever server is asked.
    - The world is looked up in the same transaction: no edit comes into a world that has been deleted.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    def append(self, drafts: Sequence[Draft]) -> list[Outcome | ChunkError]:
        """Write edits, in this order. Return for each its outcome, or why it was refused; the others do not mind.

        A draft with a seq that its client has had already, or with a key that is known, is not written again: it gets
        its first answer. It is refused with

        - `WorldGone` if its world is not kept here,
        - `BadParameter` if its key or its seq was another body's, or if its seq is below the client's highest and was
          never written: an earlier refusal was its answer, and a new one needs a new seq,
        - `StoreFull` if its world has CLIENTS_MAX clients, and this is another.

        Raises `StoreFull` if the disk is full, `StoreError` if it fails, or has failed before. Then none is written.
        """
        with self._database.write() as connection:
            transaction = _Transaction(connection)
            return [transaction.outcome(draft) for draft in drafts]

    def read(self, epoch: str, after: int, limit: int = READ_EDITS_MAX) -> list[Edit]:
        """Return edits with a revision above `after`, in order, without a hole: the first `limit`, or fewer if they are
        large; none if there are none.

        limit: 1 to READ_EDITS_MAX.

        Raises `BadParameter` if `after` is below the floor, `WorldGone`, or `StoreError`.
        """
        if not 1 <= limit <= READ_EDITS_MAX:
            raise BadParameter(f"limit is {limit}; it lies in [1, {READ_EDITS_MAX}]", limit=limit)
        with self._database.read() as connection:
            tail = _tail(connection, epoch)
            if after < tail.floor:
                message = f"after is {after}; edits up to {tail.floor} are not kept one by one any more"
                raise BadParameter(message, after=after, floor=tail.floor)
            query = (
                "SELECT revision, strokes, stale, client, seq FROM edits WHERE world = ? AND revision > ?"
                " ORDER BY revision LIMIT ?"
            )
            with closing(connection.execute(query, (tail.world, after, limit))) as rows:
                return list(_up_to(READ_BYTES_MAX, map(Edit._make, rows)))

    def revision(self, epoch: str) -> int:
        """Return how many edits a world has taken. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return _tail(connection, epoch).revision

    def floor(self, epoch: str) -> int:
        """Return up to which revision a world's edits are in its foundation. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return _tail(connection, epoch).floor

    def mark(self, epoch: str, client: str) -> int | None:
        """Return the highest seq of a client, None if it has none. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return _mark(connection, _tail(connection, epoch).world, client)

    def compact(self, epoch: str, floor: int, parts: Iterable[tuple[bytes, bytes]]) -> None:
        """Put a foundation in the place of the one before and the edits up to `floor`. Keys and seqs stay known.

        parts: name and content of each, which stand for all edits up to `floor`.

        Raises `BadParameter` if `floor` is below the one that is, or above the revision; `WorldGone`, `StoreFull` or
        `StoreError`. Then nothing has changed.
        """
        with self._database.write() as connection:
            tail = _tail(connection, epoch)
            if not tail.floor <= floor <= tail.revision:
                message = f"floor is {floor}; it lies in [{tail.floor}, {tail.revision}]"
                raise BadParameter(message, floor=floor)
            for change in _COMPACT:
                connection.execute(change, {"world": tail.world, "floor": floor})
            rows = ((tail.world, name, content) for name, content in parts)
            connection.executemany("INSERT INTO foundations (world, name, content) VALUES (?, ?, ?)", rows)

    def foundation(self, epoch: str) -> Foundation:
        """Return a world's foundation. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            tail = _tail(connection, epoch)
            rows = connection.execute(
                "SELECT name, content FROM foundations WHERE world = ? ORDER BY name", (tail.world,)
            )
            return Foundation(tail.floor, dict(rows))


_COMPACT: Final = (
    """UPDATE clients SET seq = folded.seq, revision = folded.revision FROM (
        SELECT client, max(seq) AS seq, max(revision) AS revision FROM edits
        WHERE world = :world AND revision <= :floor AND client IS NOT NULL GROUP BY client
    ) AS folded WHERE world = :world AND clients.client = folded.client""",
    """UPDATE keys SET stale = (SELECT stale FROM edits WHERE world = :world AND revision = keys.revision)
    WHERE world = :world AND revision <= :floor AND stale IS NULL""",
    "DELETE FROM edits WHERE world = :world AND revision <= :floor",
    "DELETE FROM foundations WHERE world = :world",
    "UPDATE logs SET floor = :floor WHERE world = :world",
)


@dataclass(slots=True)
class _Tail:
    """The end of a world's log."""

    world: int
    floor: int
    clients: int
    revision: int


class _Transaction:
    """The drafts of one call, one after the other. Each is looked at as a whole before anything of it is written."""

    def __init__(self, connection: apsw.Connection) -> None:
        self._connection = connection
        self._tails: dict[str, _Tail] = {}

    def outcome(self, draft: Draft) -> Outcome | ChunkError:
        """Return what became of a draft."""
        try:
            tail = self._tails.get(draft.epoch) or _tail(self._connection, draft.epoch)
            self._tails[draft.epoch] = tail
            return self._known_key(tail, draft) or self._sent_before(tail, draft) or self._written(tail, draft)
        except (BadParameter, StoreFull, WorldGone) as refusal:
            return refusal

    def _sent_before(self, tail: _Tail, draft: Draft) -> Outcome | None:
        if draft.client is None or draft.seq is None:
            return None
        where = (tail.world, draft.client, draft.seq)
        query = "SELECT revision, stale, digest FROM edits WHERE world = ? AND client = ? AND seq = ?"
        for revision, stale, digest in self._connection.execute(query, where):
            _check_body(draft, digest, f"seq {draft.seq} of client {draft.client!r}")
            return Outcome(revision, stale, duplicate=True)
        mark = _mark(self._connection, tail.world, draft.client)
        if mark is None or draft.seq > mark:
            return None
        query = "SELECT revision FROM clients WHERE world = ? AND client = ? AND seq >= ?"
        for (revision,) in self._connection.execute(query, where):
            return Outcome(revision, b"", duplicate=True)
        message = f"seq {draft.seq} of client {draft.client!r} was never written, and {mark} was: take a higher one"
        raise BadParameter(message, client=draft.client, seq=draft.seq, mark=mark)

    def _known_key(self, tail: _Tail, draft: Draft) -> Outcome | None:
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

    def _written(self, tail: _Tail, draft: Draft) -> Outcome:
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

    def _introduce(self, tail: _Tail, client: str) -> None:
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

    def _keep_key(self, tail: _Tail, draft: Draft) -> None:
        newest = self._connection.execute("SELECT max(number) FROM keys WHERE world = ?", (tail.world,)).get or 0
        self._connection.execute(
            "INSERT INTO keys (world, number, key, digest, revision) VALUES (?, ?, ?, ?, ?)",
            (tail.world, newest + 1, draft.key, draft.digest, tail.revision),
        )
        too_old = (tail.world, newest + 1 - KEYS_MAX)
        self._connection.execute("DELETE FROM keys WHERE world = ? AND number <= ?", too_old)


def _tail(connection: apsw.Connection, epoch: str) -> _Tail:
    query = "SELECT world, floor, clients, revision FROM tails WHERE epoch = ?"
    for row in connection.execute(query, (epoch,)):
        return _Tail(*row)
    raise WorldGone(f"no world of epoch {epoch!r} is kept here", epoch=epoch)


def _mark(connection: apsw.Connection, world: int, client: str) -> int | None:
    query = (
        "SELECT max(seq) FROM (SELECT max(seq) AS seq FROM edits WHERE world = :world AND client = :client"
        " UNION ALL SELECT seq FROM clients WHERE world = :world AND client = :client)"
    )
    mark: int | None = connection.execute(query, {"world": world, "client": client}).get
    return mark


def _check_body(draft: Draft, digest: bytes, name: str) -> None:
    if draft.digest != digest:
        raise BadParameter(f"{name} was used for another body", client=draft.client, seq=draft.seq, key=draft.key)


def _up_to(bytes_max: int, edits: Iterable[Edit]) -> Iterator[Edit]:
    """Yield the first edits, one in any case, that have at most so many bytes together."""
    total = 0
    for edit in edits:
        total += len(edit.strokes) + len(edit.stale)
        if total > bytes_max and total > len(edit.strokes) + len(edit.stale):
            return
        yield edit
