"""The stream of a world's edits on the event loop: a `Session`, and its sockets one after the other.

`blocking_stream.py` has the same for threads.
"""

import asyncio
import re
import ssl
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from types import TracebackType
from typing import Final, NamedTuple, Self, assert_never

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.typing import Subprotocol

from chunkserver_client.calls import Calls
from chunkserver_client.descriptors import WorldDescriptor
from chunkserver_client.edits import Stroke
from chunkserver_client.errors import EditLost, Problem, StreamEnded, Unreachable, problem
from chunkserver_client.exchange import refusal
from chunkserver_client.mesh import VOXELS_MAX, ChunkKey
from chunkserver_client.stream import (
    Ack,
    Edits,
    Ended,
    Event,
    Inbox,
    Nack,
    Refresh,
    Region,
    Resync,
    Session,
    Stale,
    StartOver,
)
from chunkserver_client.stream.inbox import Told
from chunkserver_client.stream.messages import FRAME_BYTES_MAX, Progress, Welcome

SUBPROTOCOL: Final = Subprotocol("chunkserver.v1")
EVERYWHERE: Final = Region((-VOXELS_MAX,) * 3, (VOXELS_MAX,) * 3)
OPEN_SECONDS: Final = 5.0
CLOSE_SECONDS: Final = 1.0
"""For the server to say goodbye. One that is away cannot."""
WATCH_SECONDS: Final = 0.25
"""How often somebody looks whether a connection has fallen silent."""
FRAMES_MAX: Final = 16
"""That were received and are not read yet; beyond that the socket is not read."""
LEFT: Final = 1000
FAILED: Final = 1011
REFUSED: Final = 4000
"""And the HTTP status: the code of a connection that the server did not take."""

_NAME: Final = re.compile("[!-~]{1,128}")

Answer = asyncio.Future[Ack] | Future[Ack]


class Address(NamedTuple):
    """Where streams are opened. url: of the server, http or https. headers: of each request. tls: for https."""

    url: str
    headers: dict[str, str]
    tls: ssl.SSLContext | None

    def opening(self, world: WorldDescriptor) -> connect:
        """Return the opening of a WebSocket. Deflate is off: the frames are small, and the server does not offer it."""
        return connect(
            f"{self.url.rstrip('/').replace('http', 'ws', 1)}{world.path}/stream",
            subprotocols=[SUBPROTOCOL],
            additional_headers={name: value for name, value in self.headers.items() if name == "authorization"},
            user_agent_header=self.headers.get("user-agent"),
            compression=None,
            open_timeout=OPEN_SECONDS,
            close_timeout=CLOSE_SECONDS,
            ping_interval=None,
            max_size=FRAME_BYTES_MAX,
            max_queue=FRAMES_MAX,
            ssl=(self.tls or True) if self.url.startswith("https") else None,
        )


class AsyncEditStream:
    """The stream of a world's edits: `AsyncClient.stream` opens it. Use it in an `async with` statement.

    async for event in stream: what the game should know; the README has a table of events. It raises `StreamEnded` when
    the server has ended the stream for good, and stops when this side has closed it.

    It belongs to the tasks of one event loop; events go to one of them.
    """

    def __init__(
        self, address: Address, calls: Calls, world: WorldDescriptor, name: str, regions: Iterable[Region] | None
    ) -> None:
        if not _NAME.fullmatch(name):
            raise ValueError(f"name is {name!r}: a name has 1 to 128 visible ASCII characters")
        where = [region.check() for region in ([EVERYWHERE] if regions is None else regions)]
        self._address, self._calls, self._world = address, calls, world
        self._session = Session(name, where, world.chunk_cells, time.monotonic, calls.exchange.retry)
        self._inbox = Inbox()
        self._answers: dict[int, Answer] = {}
        self._task: asyncio.Task[None] | None = None
        self._ended: int | None = None
        self._failure: Exception | None = None
        self._has_news, self._has_more = asyncio.Event(), asyncio.Event()

    async def __aenter__(self) -> Self:
        """Connect, and return when the server has said welcome.

        Raises `StreamEnded` if it will not have us; `Unreachable` if it was away for the `seconds_max` of `Retry`; and
        `Gone` if the descriptor is of another world, which had the same id.
        """
        if self._task is not None:
            raise ValueError("a stream is opened once")
        self._task = asyncio.ensure_future(self._run())
        try:
            async with asyncio.timeout(self._calls.exchange.retry.seconds_max):
                while self._session.epoch is None:
                    self._check()
                    await self._news()
            if self._session.epoch != self._world.epoch:
                told = f"{self._world.id} has the epoch {self._session.epoch}, the descriptor {self._world.epoch}"
                raise problem(410, {"title": "another world", "detail": told})
        except TimeoutError:
            await self.close()
            raise Unreachable(f"no welcome: {self._failure}") from self._failure
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Leave, and forget the edits that were not answered: await what `edit` returned for those that count."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    @property
    def revision(self) -> int:
        """Everything up to this revision is known."""
        return self._session.revision

    @property
    def epoch(self) -> str | None:
        """Of the world; a world that is deleted and created again, or put back, has another one."""
        return self._session.epoch

    @property
    def is_live(self) -> bool:
        """Whether there is a connection, on which the server has said welcome."""
        return self._session.is_live

    @property
    def unanswered(self) -> int:
        """How many edits wait for their answers."""
        return self._session.unanswered

    @property
    def are_chunks_current(self) -> bool:
        """Whether all chunks that are shown are as of everything that is known."""
        return self._session.chunks.are_current

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions that are known to be in force."""
        return self._session.regions

    def edit(self, strokes: Iterable[Stroke]) -> asyncio.Future[Ack]:
        """Send an edit, over this connection or a later one, until it is answered; it is written once.

        strokes: as in `AsyncClient.edit`; the values of a delta may be bytes, little-endian int32.

        What is returned is to be awaited when that counts. It gives the `Ack` as soon as the edit is durable; raises
        the `Problem` for which it was refused; or `EditLost`.

        Raises `ValueError` for what is too long for a frame, `OverflowError` if 1,024 edits or 16 MiB wait for their
        answers, `StreamEnded`.
        """
        answer: asyncio.Future[Ack] = asyncio.get_running_loop().create_future()
        self.submit(list(strokes), answer)
        return answer

    def submit(self, strokes: Sequence[Stroke], answer: Answer) -> None:
        """Send an edit as `edit` does, and settle a future of the caller's."""
        self._check()
        self._answers[self._session.edit(strokes)] = answer
        self._has_more.set()

    def show(self, *keys: ChunkKey) -> None:
        """Have these chunks kept up to date: a `Refresh` says when they are to be fetched, the first time too."""
        for key in keys:
            self._session.chunks.add(key)
        self._has_news.set()

    def hide(self, *keys: ChunkKey) -> None:
        """Hear of these chunks no more."""
        for key in keys:
            self._session.chunks.remove(key)

    def shown(self, refresh: Refresh, revision: int | None = None) -> None:
        """Tell that all chunks of a refresh have come and are shown.

        revision: the lowest `World-Revision` of them, if that is known: what they have already is not asked for again.
        """
        self._session.chunks.done(refresh, refresh.revision if revision is None else revision)
        self._has_news.set()

    def failed(self, refresh: Refresh) -> None:
        """Tell that chunks of a refresh have not come: it comes once more."""
        self._session.chunks.failed(refresh)
        self._has_news.set()

    def subscribe(self, *regions: Region) -> None:
        """Look at these regions too. Chunks in them that are shown are fetched again when that is in force.

        Raises `ValueError` for what is no region, and for more than 64 of them, and changes nothing then.
        """
        self._session.subscribe(*regions)
        self._has_more.set()

    def unsubscribe(self, *regions: Region) -> None:
        """Look at these regions no more."""
        self._session.unsubscribe(*regions)
        self._has_more.set()

    def poll(self) -> list[Told]:
        """Return all events that there are, without waiting: for a game that looks once a frame."""
        found = []
        while (event := self._inbox.take(self._session.chunks)) is not None:
            found.append(event)
        if not found and self._ended != LEFT:
            self._check()
        return found

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Told:
        while (event := self._inbox.take(self._session.chunks)) is None:
            if self._ended == LEFT:
                raise StopAsyncIteration
            self._check()
            await self._news()
        return event

    def _check(self) -> None:
        if self._ended is not None:
            raise StreamEnded(self._ended) from self._failure

    async def _news(self) -> None:
        self._has_news.clear()
        await self._has_news.wait()

    async def _run(self) -> None:
        """Connect, again and again."""
        code = FAILED
        try:
            while (at := self._session.connect_at) is not None:
                await asyncio.sleep(max(0.0, at - time.monotonic()))
                self._note(self._session.lost(await self._connection()))
        except asyncio.CancelledError:
            code = LEFT
        except Exception as error:
            self._failure = error
            raise
        finally:
            self._end(code)

    async def _connection(self) -> int | None:
        """Be connected once. Return the code with which that ended, None without one."""
        try:
            async with self._address.opening(self._world) as socket:
                self._session.connected()
                await self._carry(socket)
        except InvalidStatus as error:
            response = error.response
            headers = {name.lower(): value for name, value in response.headers.raw_items()}
            self._failure = refusal(response.status_code, headers, bytes(response.body or b""))
            return REFUSED + response.status_code
        except (OSError, EOFError, WebSocketException) as error:
            self._failure = error
            return None
        self._failure = None
        return socket.close_code

    async def _carry(self, socket: ClientConnection) -> None:
        """Carry messages both ways. Returns when one of them ends, or nothing comes any more."""
        tasks = [asyncio.ensure_future(each) for each in (self._read(socket), self._send(socket), self._watch())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            found = await asyncio.gather(*tasks, return_exceptions=True)
        for each in found:
            if isinstance(each, Exception) and not isinstance(each, ConnectionClosed):
                raise each

    async def _read(self, socket: ClientConnection) -> None:
        while not self._session.is_broken:
            frame = await socket.recv()
            self._note(self._session.received(frame), len(frame))
            self._has_more.set()

    async def _send(self, socket: ClientConnection) -> None:
        while True:
            self._has_more.clear()
            for frame in self._session.outgoing():
                await socket.send(frame)
            await self._has_more.wait()

    async def _watch(self) -> None:
        while not self._session.is_broken:
            await asyncio.sleep(WATCH_SECONDS)

    def _note(self, events: Iterable[Event], size: int = 0) -> None:
        """Tell the game, those who wait for answers, and the client's cache."""
        for event in events:
            self._settle(event)
            if isinstance(event, Ended):
                self._end(event.code)
            elif not isinstance(event, Welcome):
                self._inbox.put(event, size, self._session.revision)
        self._has_news.set()

    def _settle(self, event: Event) -> None:
        match event:
            case Ack(seq, revision, _, stale):
                self._calls.outdate(self._world, stale, revision)
                self._answered(seq, event)
            case Nack(seq, why):
                self._answered(seq, why)
            case Edits() | Stale():
                self._calls.outdate(self._world, event.stale, event.revision)
            case Resync():
                self._calls.outdate(self._world, None, event.revision)
            case StartOver(_, revision, lost):
                self._calls.outdate(self._world, None, revision)
                for seq in lost:
                    self._answered(seq, EditLost(seq, "the world has begun anew"))
            case Welcome() | Progress() | Ended():
                pass
            case _:
                assert_never(event)

    def _answered(self, seq: int, found: Ack | Problem | EditLost) -> None:
        answer = self._answers.pop(seq, None)
        if answer is None or answer.done():
            return
        if isinstance(found, Ack):
            answer.set_result(found)
        else:
            answer.set_exception(found)
            answer.exception()  # who never looks need not be told

    def _end(self, code: int) -> None:
        """Be over, if it is not yet."""
        if self._ended is None:
            self._ended = code
            for seq in tuple(self._answers):
                self._answered(seq, EditLost(seq, str(StreamEnded(code))))
        self._has_news.set()
