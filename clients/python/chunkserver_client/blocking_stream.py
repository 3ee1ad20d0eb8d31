"""The stream of a world's edits for threads: that of the event loop, on a loop in a thread of its own."""

import asyncio
import threading
from collections.abc import Callable, Coroutine, Iterable
from concurrent.futures import CancelledError, Future
from types import TracebackType
from typing import Any, Self, TypeVar

from chunkserver_client.calls import Calls
from chunkserver_client.descriptors import WorldDescriptor
from chunkserver_client.edit_stream import CLOSE_SECONDS, Address, AsyncEditStream
from chunkserver_client.edits import Stroke
from chunkserver_client.mesh import ChunkKey
from chunkserver_client.stream import Ack, Refresh, Region
from chunkserver_client.stream.inbox import Told

_Value = TypeVar("_Value")


class EditStream:
    """The stream of a world's edits: `Client.stream` opens it. Use it in a `with` statement.

    for event in stream: what the game should know; the README has a table of events. It raises `StreamEnded` when the
    server has ended the stream for good, and stops when this side has closed it.

    It may be shared by threads; events go to one of them. It reads and sends in a thread of its own, from `with` to
    `close`.
    """

    def __init__(
        self, address: Address, calls: Calls, world: WorldDescriptor, name: str, regions: Iterable[Region] | None
    ) -> None:
        self._stream = AsyncEditStream(address, calls, world, name, regions)
        self._loop: asyncio.AbstractEventLoop
        self._runs = threading.Event()
        self._gate = threading.Lock()
        self._is_open = False
        self._thread = threading.Thread(target=self._turn, name=f"edits of {world.id}", daemon=True)

    def __enter__(self) -> Self:
        """Connect, and return when the server has said welcome. Raises as `AsyncEditStream` does."""
        self._thread.start()
        self._runs.wait()
        try:
            opened = self._begun(self._stream.__aenter__())
            if opened is not None:
                _result(opened)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave, and forget the edits that were not answered: ask what `edit` returned for those that count."""
        left = self._begun(self._leave(), is_last=True)
        own = threading.current_thread() is self._thread  # in a callback of what `edit` has returned
        if (left is not None or self._runs.is_set()) and not own:
            self._thread.join()

    @property
    def revision(self) -> int:
        """Everything up to this revision is known."""
        return self._stream.revision

    @property
    def epoch(self) -> str | None:
        """Of the world; a world that is deleted and created again, or put back, has another one."""
        return self._stream.epoch

    @property
    def is_live(self) -> bool:
        """Whether there is a connection, on which the server has said welcome."""
        return self._stream.is_live

    @property
    def unanswered(self) -> int:
        """How many edits wait for their answers."""
        return self._stream.unanswered

    @property
    def are_chunks_current(self) -> bool:
        """Whether all chunks that are shown are as of everything that is known."""
        return self._stream.are_chunks_current

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions that are known to be in force."""
        return self._do(lambda: self._stream.regions)

    def edit(self, strokes: Iterable[Stroke]) -> Future[Ack]:
        """Send an edit, over this connection or a later one, until it is answered; it is written once.

        strokes: as in `Client.edit`; the values of a delta may be bytes, little-endian int32.

        What is returned is to be asked for its `result(seconds)` when that counts. It gives the `Ack` as soon as the
        edit is durable; raises the `Problem` for which it was refused; or `EditLost`.

        Raises `ValueError` for what is too long for a frame, `OverflowError` if 1,024 edits or 16 MiB wait for their
        answers, `StreamEnded`.
        """
        answer: Future[Ack] = Future()
        answer.set_running_or_notify_cancel()
        given = list(strokes)
        self._do(lambda: self._stream.submit(given, answer))
        return answer

    def show(self, *keys: ChunkKey) -> None:
        """Have these chunks kept up to date: a `Refresh` says when they are to be fetched, the first time too."""
        self._do(lambda: self._stream.show(*keys))

    def hide(self, *keys: ChunkKey) -> None:
        """Hear of these chunks no more."""
        self._do(lambda: self._stream.hide(*keys))

    def shown(self, refresh: Refresh, revision: int | None = None) -> None:
        """Tell that all chunks of a refresh have come and are shown.

        revision: the lowest `World-Revision` of them, if that is known: what they have already is not asked for again.
        """
        self._do(lambda: self._stream.shown(refresh, revision))

    def failed(self, refresh: Refresh) -> None:
        """Tell that chunks of a refresh have not come: it comes once more."""
        self._do(lambda: self._stream.failed(refresh))

    def subscribe(self, *regions: Region) -> None:
        """Look at these regions too. Chunks in them that are shown are fetched again when that is in force.

        Raises `ValueError` for what is no region, and for more than 64 of them, and changes nothing then.
        """
        self._do(lambda: self._stream.subscribe(*regions))

    def unsubscribe(self, *regions: Region) -> None:
        """Look at these regions no more."""
        self._do(lambda: self._stream.unsubscribe(*regions))

    def poll(self) -> list[Told]:
        """Return all events that there are, without waiting: for a game that looks once a frame."""
        return self._do(self._stream.poll)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Told:
        found = self._begun(self._stream.__anext__())
        if found is None:
            raise StopIteration
        try:
            return _result(found)
        except (StopAsyncIteration, CancelledError):
            raise StopIteration from None

    def _turn(self) -> None:
        with asyncio.Runner() as runner:
            self._loop = runner.get_loop()
            self._is_open = True
            self._runs.set()
            self._loop.run_forever()

    async def _leave(self) -> None:
        """Close, and stop the loop when all that it was asked for before has come to its end."""
        try:
            await self._stream.close()
            others = asyncio.all_tasks() - {asyncio.current_task()}
            if others:
                await asyncio.wait(others, timeout=CLOSE_SECONDS)
        finally:
            self._loop.stop()

    def _do(self, call: Callable[[], _Value]) -> _Value:
        """Return what a function returns on the loop; here, when that has stopped: nobody else is there then."""
        if threading.current_thread() is self._thread:
            return call()

        async def called() -> _Value:
            return call()

        found = self._begun(called())
        if found is not None:
            return _result(found)
        self._thread.join()
        with self._gate:
            return call()

    def _begun(self, work: Coroutine[Any, Any, _Value], *, is_last: bool = False) -> Future[_Value] | None:
        """Have a coroutine run on the loop; None if that takes no more. is_last: it takes no more after this.

        Raises `ValueError` if it never ran.
        """
        with self._gate:
            if self._is_open:
                self._is_open = not is_last
                return asyncio.run_coroutine_threadsafe(work, self._loop)
        work.close()
        if not self._runs.is_set() and not is_last:
            raise ValueError("the stream is not open")
        return None


def _result(found: Future[_Value]) -> _Value:
    """Wait for what a coroutine returns. Who is interrupted meanwhile ends it."""
    try:
        return found.result()
    except BaseException:
        found.cancel()
        raise
