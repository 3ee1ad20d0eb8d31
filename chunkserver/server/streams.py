"""The streams of all worlds on the event loop: what is written reaches all who listen, what they send is written.

Editing.told -> Stream.written -> connections     a tick for all, every TICK_SECONDS, while anybody listens
connection -> Journal -> Editing.take, the log
"""

import asyncio
import logging
import time
from collections.abc import Callable, Container, Coroutine, Iterator
from contextlib import contextmanager
from typing import Any, Final
from weakref import WeakSet

from chunkserver.edits import Edit
from chunkserver.errors import BadParameter, ChunkError, WorldGone
from chunkserver.server.editing import Editing
from chunkserver.server.keys import Scope
from chunkserver.server.problems import ScopeNeeded, problem_body, problem_of
from chunkserver.server.replays import Replays
from chunkserver.server.share import Shares
from chunkserver.store import Draft, Store
from chunkserver.stream import Connection, Stream, StreamEdit, closing, limits
from chunkserver.world import World

_log: Final = logging.getLogger(__name__)


class Streams:
    """The streams of one server. Belongs to the event loop.

    opened: how many connections there have been. closed: how many of them ended, by the code.
    """

    def __init__(self, editing: Editing, store: Store, shares: Shares | None = None) -> None:
        """shares: of the event loop's time, that those who resume have part in."""
        self.opened = 0
        self.closed: dict[int, int] = {}
        self._editing, self._store, self._shares = editing, store, shares or Shares()
        self._streams: dict[str, tuple[World, Stream]] = {}
        self._readers: WeakSet[Connection] = WeakSet()
        self._tasks: set[asyncio.Task[None]] = set()
        self._ticking: asyncio.Task[None] | None = None
        editing.told, editing.gone = self._told, self.forget

    @property
    def connections(self) -> int:
        """How many connections there are."""
        return sum(len(stream) for _, stream in self._streams.values())

    async def connect(self, world: World, wake: Callable[[], None], *, may_edit: bool) -> Connection:
        """Return a new connection to a world. Raises what `Editing.open` does.

        wake: see `Stream.connect`. may_edit: else its edits are refused.
        """
        await self._editing.open(world)
        found = self._streams.get(world.epoch)
        if found is None:
            journal = _Journal(world, self._editing, self._store, self._readers, self._do, self._shares)
            stream = Stream(world.epoch, self._editing.revision(world), journal, time.monotonic)
            found = self._streams[world.epoch] = world, stream
        self.opened += 1
        if self._ticking is None or self._ticking.done():
            self._ticking = asyncio.ensure_future(self._tick())
        connection = found[1].connect(wake)
        if not may_edit:
            self._readers.add(connection)
        return connection

    def left(self, connection: Connection, why: closing.Close = closing.LEFT) -> None:
        """Take that the peer of a connection is gone, and why; or that it was closed."""
        connection.close(why)
        assert connection.closing is not None
        code = connection.closing.code
        self.closed[code] = self.closed.get(code, 0) + 1

    def forget(self, epoch: str) -> None:
        """Close the stream of a world that is gone."""
        found = self._streams.pop(epoch, None)
        if found is not None:
            found[1].close(closing.GONE)

    async def close(self) -> None:
        """Close all streams."""
        for _, stream in self._streams.values():
            stream.close()
        self._streams.clear()
        tasks = [task for task in (*self._tasks, self._ticking) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _told(self, draft: Draft, revision: int) -> None:
        found = self._streams.get(draft.epoch)
        if found is not None:
            world, stream = found
            cells = world.chunk_cells
            try:
                stream.written(StreamEdit(revision, draft.strokes, draft.stale, cells, draft.client, draft.seq))
            except Exception:  # noqa: BLE001 - whatever it was: who resumes misses nothing
                self._failed(world, stream)

    async def _tick(self) -> None:
        """Tick while anybody is connected."""
        while self.connections:
            for world, stream in tuple(self._streams.values()):
                try:
                    stream.tick()
                except Exception:  # noqa: BLE001 - whatever it was: the streams of other worlds go on
                    self._failed(world, stream)
            await asyncio.sleep(limits.TICK_SECONDS)
            self._streams = {epoch: found for epoch, found in self._streams.items() if len(found[1])}

    def _failed(self, world: World, stream: Stream) -> None:
        """End a stream that an exception was raised in. Its peers connect again, and resume on a new one."""
        _log.exception("the stream of world %s ends", world.id)
        self._streams.pop(world.epoch, None)
        stream.close(closing.FAILED)

    def _do(self, connection: Connection, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(_done(connection, work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


class _Journal:
    """What the connections of one world ask of its log. See `stream.Journal`."""

    def __init__(
        self,
        world: World,
        editing: Editing,
        store: Store,
        readers: Container[Connection],
        do: Callable[[Connection, Coroutine[Any, Any, None]], None],
        shares: Shares,
    ) -> None:
        """readers: connections that may not edit. do: runs something for a connection in a task."""
        self._world, self._editing, self._log, self._readers, self._do = world, editing, store.log, readers, do
        self._replays = Replays(world, store.log, shares)

    def introduce(self, connection: Connection, client: str) -> None:
        """Look up the client's highest seq, and the floor."""
        self._do(connection, self._introduce(connection, client))

    def submit(self, connection: Connection, client: str, seq: int, strokes: list[Any]) -> None:
        """Write an edit. One that is none is refused at once: so the sender's share pays for it."""
        with _ending(connection):
            try:
                with self._editing.counts.refusals():
                    if connection in self._readers:
                        message = "to edit needs scope edit; this connection may only read"
                        raise ScopeNeeded(message, scope=str(Scope.EDIT))
                    edit = Edit.of(strokes)
            except ChunkError as error:
                _refuse(connection, seq, error)
            else:
                self._do(connection, self._submit(connection, client, seq, edit))

    def replay(self, connection: Connection, after: int) -> None:
        """Read the edits behind a revision, some at once."""
        self._do(connection, self._replay(connection, after))

    async def _introduce(self, connection: Connection, client: str) -> None:
        epoch, log = self._world.epoch, self._log
        try:
            mark, floor = await asyncio.to_thread(lambda: (log.mark(epoch, client), log.floor(epoch)))
        except ChunkError as error:
            _fail(connection, error)
        else:
            connection.introduced(mark, floor)

    async def _submit(self, connection: Connection, client: str, seq: int, edit: Edit) -> None:
        try:
            with self._editing.counts.refusals():
                answer = await self._editing.take(self._world, edit, client=client, seq=seq)
        except ChunkError as error:
            _refuse(connection, seq, error)
        else:
            if answer.duplicate:
                connection.repeated(seq, answer.revision, answer.stale)

    async def _replay(self, connection: Connection, after: int) -> None:
        epoch, log = self._world.epoch, self._log
        try:
            try:
                found = await self._replays.after(after)
            except BadParameter:
                connection.compacted(await asyncio.to_thread(log.floor, epoch))
                return
            floor = await asyncio.to_thread(log.floor, epoch)
        except ChunkError as error:
            _fail(connection, error)
        else:
            with self._replays.share.used():
                connection.replayed(found, floor)


async def _done(connection: Connection, work: Coroutine[Any, Any, None]) -> None:
    with _ending(connection):
        await work


@contextmanager
def _ending(connection: Connection) -> Iterator[None]:
    """End a connection that something fails for. Whoever waits for what is never answered asks again on another one."""
    try:
        yield
    except Exception:  # noqa: BLE001 - whatever it was: without a word the peer would wait for ever
        _log.exception("a stream of edits ends")
        connection.close(closing.FAILED)


def _refuse(connection: Connection, seq: int, error: ChunkError) -> None:
    connection.refused(seq, problem_body(problem_of(type(error)), error.message, error.values))


def _fail(connection: Connection, error: ChunkError) -> None:
    if not isinstance(error, WorldGone):
        _log.error("a stream of edits ends: %s", error)
    connection.close(closing.GONE if isinstance(error, WorldGone) else closing.FAILED)
