"""What waits to be sent on one connection: a bounded queue, and how long nothing was taken from it."""

from collections import deque
from collections.abc import Callable

from chunkserver.stream.limits import QUEUE_BYTES_MAX, SEND_SECONDS


class Outbox:
    """Frames in their order. The first stays until it is sent, so that one that nobody takes is seen.

    clock: seconds. wake: called when there is something to send again.
    """

    def __init__(self, clock: Callable[[], float], wake: Callable[[], None]) -> None:
        self._clock, self._wake = clock, wake
        self._frames: deque[bytes] = deque()
        self._bytes = 0
        self._moved_at = clock()

    @property
    def has_room(self) -> bool:
        """Whether more should be put. What is put nevertheless is sent too."""
        return self._bytes < QUEUE_BYTES_MAX

    @property
    def is_stuck(self) -> bool:
        """Whether nothing was taken for too long."""
        return bool(self._frames) and self._clock() - self._moved_at > SEND_SECONDS

    def put(self, frame: bytes) -> None:
        """Put a frame behind the others."""
        self._frames.append(frame)
        self._bytes += len(frame)
        if len(self._frames) == 1:
            self._moved_at = self._clock()
            self._wake()

    def front(self) -> bytes | None:
        """Return the frame that is to be sent next; None if there is none."""
        return self._frames[0] if self._frames else None

    def sent(self) -> None:
        """Note that the front was sent."""
        self._bytes -= len(self._frames.popleft())
        self._moved_at = self._clock()

    def clear(self) -> None:
        """Forget all of it."""
        self._frames.clear()
        self._bytes = 0
