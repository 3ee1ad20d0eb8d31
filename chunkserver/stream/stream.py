"""The stream of one world: who is connected, and the edits that all of them are told."""

from collections.abc import Callable

from chunkserver.stream import answers, closing
from chunkserver.stream.closing import Close
from chunkserver.stream.connection import Connection, Journal
from chunkserver.stream.edit import StreamEdit, StreamEdits, edits_in
from chunkserver.stream.limits import REPLAYED_AT_ONCE_MAX
from chunkserver.stream.recent import Recent
from chunkserver.stream.regions import Regions


class Stream:
    """One world's stream. Pure: clock, log and sockets are somebody else's.

    epoch: of the world. recent: its last edits; `recent.end` is its revision.
    journal: who writes edits and reads them. clock: seconds, never going back.
    """

    def __init__(self, epoch: str, revision: int, journal: Journal, clock: Callable[[], float]) -> None:
        self.epoch = epoch
        self.recent = Recent(revision)
        self._journal, self._clock = journal, clock
        self._connections: dict[Connection, None] = {}
        self._clients: dict[str, Connection] = {}
        self._matching: dict[tuple[int, Regions], tuple[StreamEdits, StreamEdits]] = {}
        self._messages: dict[tuple[int, StreamEdits, int], list[tuple[bytes, int]]] = {}

    def __len__(self) -> int:
        """Return how many connections there are."""
        return len(self._connections)

    def connect(self, wake: Callable[[], None]) -> Connection:
        """Return a new connection.

        wake: called when it has something to send again, may be read again, or closes. That is in the middle of things:
            it should be noted, and the connection not be called.
        """
        connection = Connection(self, self._journal, self._clock, wake)
        self._connections[connection] = None
        return connection

    def written(self, edit: StreamEdit) -> None:
        """Take the next edit of the world, which is durable: its client is answered now, the others at the next tick.

        Every edit of the world comes this way, whoever sent it and however.
        """
        self._forget()
        self.recent.add(edit)
        if edit.client is not None and (connection := self._clients.get(edit.client)) is not None:
            connection.written(edit)
        kept = self.recent.first_kept
        if kept > self.recent.start:
            for connection in tuple(self._connections):
                connection.overtaken(kept)
            self.recent.trim()
            self._forget()

    def tick(self) -> None:
        """Tell everybody what there is. To be called every TICK_SECONDS."""
        for connection in tuple(self._connections):
            connection.tick()
        self._forget()

    def close(self, why: Close = closing.GOING_AWAY) -> None:
        """End all connections."""
        for connection in tuple(self._connections):
            connection.close(why)

    def joined(self, connection: Connection, client: str) -> None:
        """Take in a connection that has been introduced, in the place of any other of this client."""
        before = self._clients.get(client)
        self._clients[client] = connection
        if before is not None:
            before.close(closing.REPLACED)

    def left(self, connection: Connection) -> None:
        """Let go of a connection that is closed."""
        self._connections.pop(connection, None)
        if connection.client is not None and self._clients.get(connection.client) is connection:
            del self._clients[connection.client]

    def matching(self, after: int, regions: Regions) -> tuple[StreamEdits, StreamEdits] | None:
        """Return the next recent edits, and those of them in the regions; None if some are not kept any more."""
        known = self._matching.get((after, regions))
        if known is None:
            some = self.recent.after(after, REPLAYED_AT_ONCE_MAX)
            if some is None:
                return None
            known = self._matching[after, regions] = some, edits_in(some, regions)
        return known

    def messages(self, after: int, edits: StreamEdits, revision: int) -> list[tuple[bytes, int]]:
        """Return what `answers.edits` does: made once for all who have got equally far."""
        known = self._messages.get((after, edits, revision))
        if known is None:
            known = self._messages[after, edits, revision] = answers.edits(after, edits, revision)
        return known

    def _forget(self) -> None:
        self._matching.clear()
        self._messages.clear()
