"""The log of edits: what was acknowledged, in order. It is the truth; what is made of it can be made again.

    revision    1 2 3 ...  floor  |  floor + 1 ... foundation ...  revision
                                     edits, each as it was sent
                -----------------------------------
                the foundation stands for these

A world is named by its epoch. Strokes and what they make stale are bytes that mean nothing here.
"""

import threading
from collections.abc import Iterable, Sequence
from contextlib import closing
from typing import Final, NamedTuple

from chunkserver.errors import BadParameter, ChunkError
from chunkserver.store import foundation, sweeping
from chunkserver.store.appending import Appending
from chunkserver.store.draft import EDIT_BYTES_MAX, Draft, Outcome
from chunkserver.store.foundation import Foundation, Part
from chunkserver.store.portions import portions
from chunkserver.store.sqlite import Database
from chunkserver.store.tail import mark_of, tail_of

READ_EDITS_MAX: Final = 10_000
READ_BYTES_MAX: Final = 16 << 20
"""Of one `read`; an edit that is larger comes alone."""

assert READ_BYTES_MAX >= EDIT_BYTES_MAX


class Edit(NamedTuple):
    """An edit as it was written."""

    revision: int
    strokes: bytes
    stale: bytes
    client: str | None
    seq: int | None


class EditLog:
    """The edits of all worlds of a database. Safe in any thread; no thread but the `Writer`'s should append.

    Another store can stand in its place if it has these methods, and promises this:

    - When `append` or `lay` returns, what it says is durable. When it raises, nothing of it is there, neither now
      nor after a restart; but for a commit of which nobody can say how it ended: then all or nothing of it is there
      after the restart, and nothing more is written before.
    - No transaction is long, but one with a long edit: `lay` and `sweep` let others in between their steps.
    - All drafts of one call are one transaction. Revisions of a world are 1, 2, 3 ... without a hole, in the order of
      the drafts; readers see them in that order and never one without those before it. (A counter of the world that
      is raised in the same transaction does that. A sequence of the database does not: its order is not that of the
      commits.)
    - A world has a seq of a client once, and a key once, whichever server is asked.
    - The world is looked up in the same transaction: no edit comes into a world that has been deleted.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._laying = threading.Lock()
        self._laid: int | None = None

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
            appending = Appending(connection)
            return [appending.outcome(draft) for draft in drafts]

    def read(self, epoch: str, after: int, limit: int = READ_EDITS_MAX) -> list[Edit]:
        """Return edits with a revision above `after`, in order, without a hole: the first `limit`, or fewer if they are
        large; none if there are none.

        limit: 1 to READ_EDITS_MAX.

        Raises `BadParameter` if `after` is below the floor, `WorldGone`, or `StoreError`.
        """
        if not 1 <= limit <= READ_EDITS_MAX:
            raise BadParameter(f"limit is {limit}; it lies in [1, {READ_EDITS_MAX}]", limit=limit)
        with self._database.read() as connection:
            tail = tail_of(connection, epoch)
            if after < tail.floor:
                message = f"after is {after}; edits up to {tail.floor} are not kept one by one any more"
                raise BadParameter(message, after=after, floor=tail.floor)
            query = (
                "SELECT revision, strokes, stale, client, seq FROM edits WHERE world = ? AND revision > ?"
                " ORDER BY revision LIMIT ?"
            )
            with closing(connection.execute(query, (tail.world, after, limit))) as rows:
                edits = map(Edit._make, rows)
                return next(
                    portions(edits, lambda edit: len(edit.strokes) + len(edit.stale), limit, READ_BYTES_MAX), []
                )

    def revision(self, epoch: str) -> int:
        """Return how many edits a world has taken. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return tail_of(connection, epoch).revision

    def migrated(self, epoch: str) -> int:
        """Return up to which revision edits were made in another generator's terrain; 0 if none was.

        Raises `WorldGone` or `StoreError`.
        """
        with self._database.read() as connection:
            number = tail_of(connection, epoch).world
            migrated: int = connection.execute("SELECT migrated FROM logs WHERE world = ?", (number,)).get
            return migrated

    def floor(self, epoch: str) -> int:
        """Return up to which revision a world's edits cannot be read any more. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return tail_of(connection, epoch).floor

    def mark(self, epoch: str, client: str) -> int | None:
        """Return the highest seq of a client, None if it has none. Raises `WorldGone` or `StoreError`."""
        with self._database.read() as connection:
            return mark_of(connection, tail_of(connection, epoch).world, client)

    def lay(self, epoch: str, revision: int, parts: Iterable[Part]) -> None:
        """Give a world another foundation, that of `revision`. The floor gets to the revision of the one before: the
        edits from there on can still be read. A log without any edit can begin so, with its floor there too.

        parts: name and content of each, PART_BYTES_MAX at most; together they stand for all edits up to `revision`.
            They are written in steps, between which others write, and are taken as they are needed.

        Lays take turns. Raises `BadParameter` if `revision` is below that of the foundation that is, or above the
        world's, or a part is too large; `WorldGone`, `StoreFull` or `StoreError`. Then the foundation stays as it was.
        """
        with self._laying:
            try:
                with self._database.write() as connection:
                    tail = tail_of(connection, epoch)
                    number = foundation.begin(connection, tail, revision)
                    self._laid = tail.world  # before a sweep can see it
                for step in foundation.steps(parts):
                    with self._database.write() as connection:
                        tail_of(connection, epoch)
                        foundation.add(connection, number, step)
                with self._database.write() as connection:
                    foundation.lay(connection, tail_of(connection, epoch), number, revision)
            finally:
                self._laid = None

    def foundation(self, epoch: str) -> Foundation:
        """Return a world's foundation. Raises `WorldGone` or `StoreError`."""
        return foundation.read(self._database, epoch)

    def sweep(self) -> bool:
        """Delete some of what nothing refers to any more: edits up to the floors, parts of other foundations, what
        worlds have left that were deleted. One short transaction. Call it again until it returns False: nothing is left
        then, but of a world that gets a foundation just now.

        No answer depends on it, but two: a seq that comes again below the floor gets its own first answer until its
        edit is swept, and a body that differs is refused until then. Raises `StoreFull` or `StoreError`.
        """
        with self._database.write() as connection:
            return sweeping.sweep(connection, self._laid)


def _weight(edit: Edit) -> int:
    return len(edit.strokes) + len(edit.stale)
