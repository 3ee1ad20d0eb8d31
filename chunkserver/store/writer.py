"""One thread that writes edits: all that wait are one transaction, and so share its sync."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Final

from chunkserver.errors import ChunkError, Overloaded, StoreError
from chunkserver.store.draft import EDIT_BYTES_MAX, Draft, Outcome

DRAFTS_WAITING_MAX: Final = 10_000
BYTES_WAITING_MAX: Final = 64 << 20
"""Drafts that wait, and what they weigh: beyond that, one more is refused."""
DRAFTS_AT_ONCE_MAX: Final = 1000
BYTES_AT_ONCE_MAX: Final = 16 << 20
"""Of one transaction."""

assert BYTES_WAITING_MAX >= BYTES_AT_ONCE_MAX >= EDIT_BYTES_MAX

Append = Callable[[Sequence[Draft]], list[Outcome | ChunkError]]

_Waiting = tuple[Draft, Future[Outcome]]


class Writer:
    """Writes drafts in the order in which they come, over all worlds. Safe in any thread.

    append: writes drafts as one transaction; durable when it returns. `EditLog.append`.
    """

    def __init__(self, append: Append) -> None:
        self._append = append
        self._changed = threading.Condition()
        self._waiting: deque[_Waiting] = deque()
        self._bytes = 0
        self._closing = False
        self._thread: threading.Thread | None = None

    def submit(self, draft: Draft) -> Future[Outcome]:
        """Return what has a result once the disk has the edit, or the error that refused it. It cannot be cancelled.

        Raises `Overloaded` if too much waits, `StoreError` after `close`. Then the draft was not taken.
        """
        future: Future[Outcome] = Future()
        future.set_running_or_notify_cancel()
        with self._changed:
            if self._closing:
                raise StoreError("the log of edits is closed")
            if len(self._waiting) >= DRAFTS_WAITING_MAX or self._bytes + draft.weight > BYTES_WAITING_MAX:
                message = f"{len(self._waiting)} edits of {self._bytes} bytes wait to be written, which is the limit"
                raise Overloaded(message, waiting=len(self._waiting))
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="edits")
                thread.start()
                self._thread = thread
            self._waiting.append((draft, future))
            self._bytes += draft.weight
            self._changed.notify()
        return future

    def close(self) -> None:
        """Write what waits, and end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while self._write(self._next()):
            pass

    def _write(self, batch: list[_Waiting]) -> bool:
        """Write one batch, and keep nothing of it. Return whether it has any drafts."""
        for (_, future), outcome in zip(batch, self._outcomes([draft for draft, _ in batch]), strict=True):
            if isinstance(outcome, BaseException):
                future.set_exception(outcome)
            else:
                future.set_result(outcome)
        return bool(batch)

    def _outcomes(self, drafts: list[Draft]) -> Sequence[Outcome | BaseException]:
        try:
            return self._append(drafts) if drafts else []
        except BaseException as error:  # noqa: BLE001 - whoever waits is told, and the thread lives on
            return [error] * len(drafts)

    def _next(self) -> list[_Waiting]:
        """Wait for drafts, and return those of the next transaction; none if it is time to end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing)
            batch: list[_Waiting] = []
            weight = 0
            while self._waiting and len(batch) < DRAFTS_AT_ONCE_MAX:
                weight += self._waiting[0][0].weight
                if weight > BYTES_AT_ONCE_MAX:
                    break
                batch.append(self._waiting.popleft())
            self._bytes -= sum(draft.weight for draft, _ in batch)
            return batch
