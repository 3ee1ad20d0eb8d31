"""A lock that nobody takes twice while others wait."""

import threading
from types import TracebackType


class Turns:
    """A lock. Whoever waits first gets it next: a thread that gives it back and wants it again comes behind that one.

    (A plain lock goes to who is awake, and that is who has just had it.) Not reentrant.
    """

    def __init__(self) -> None:
        self._next = threading.Lock()
        self._turn = threading.Lock()

    def __enter__(self) -> None:
        with self._next:
            self._turn.acquire()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._turn.release()
