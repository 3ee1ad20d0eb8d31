"""What is asked, what is answered, and what became of it: the values that all other files speak of."""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

Key = tuple[int, int, int, int]
"""lod, x, y, z of a chunk."""


class Request(NamedTuple):
    """What to ask for.

    path: with its query. kind: under which it is counted; a few names, given by a profile.
    keys: the chunk that is asked for, or those of a batch, in its order; empty: whatever comes is no chunk.
    etag: quoted, to be sent as `If-None-Match`. urgency: of RFC 9218, 0 to 7. coding: for `Accept-Encoding`.
    body: makes it a POST of JSON, a batch.
    """

    path: str
    kind: str = "chunk"
    keys: tuple[Key, ...] = ()
    etag: str = ""
    urgency: int | None = None
    coding: str = ""
    body: bytes = b""

    def wire(self, fixed: bytes) -> bytes:
        """Return the bytes of the request. fixed: header lines that all requests have, each with its end."""
        head = f"{'POST' if self.body else 'GET'} {self.path} HTTP/1.1\r\n"
        if self.etag:
            head += f"If-None-Match: {self.etag}\r\n"
        if self.coding:
            head += f"Accept-Encoding: {self.coding}\r\n"
        if self.urgency is not None:
            head += f"Priority: u={self.urgency}\r\n"
        if self.body:
            head += f"Content-Type: application/json\r\nContent-Length: {len(self.body)}\r\n"
        return head.encode() + fixed + b"\r\n" + self.body


class Answer(NamedTuple):
    """What came. head: from the status line on, each field behind a line end; read when somebody asks for a field.

    pieces: the body, as it came.
    """

    status: int
    head: bytes
    pieces: tuple[bytes, ...]

    @property
    def body(self) -> bytes:
        """The whole body, still coded."""
        return self.pieces[0] if len(self.pieces) == 1 else b"".join(self.pieces)

    def text(self, name: bytes) -> str:
        """Return a header field, the first of its name; empty if there is none."""
        found = re.search(rb"(?i)\r\n" + name + rb":[ \t]*([^\r\n]*)", self.head)
        return found[1].rstrip().decode("latin-1") if found else ""


@dataclass(slots=True)
class Exchange:
    """One request and what became of it. Times are of `time.perf_counter`, in seconds.

    due: when it was to be sent. sent: when it was. ended: when its answer was complete, or could not come any more.
    answer: None if there was none; then `failure` says why, and `detail` with which values.
    received: bytes of the answer, its head included. arrivals: of a batch, when how many bytes of the body had come.
    """

    request: Request
    due: float
    sent: float = 0.0
    ended: float = 0.0
    answer: Answer | None = None
    failure: str = ""
    detail: str = ""
    received: int = 0
    arrivals: list[tuple[int, float]] = field(default_factory=list)

    @property
    def latency(self) -> float:
        """Seconds from when it was due: what a user waits, whoever is to blame."""
        return self.ended - self.due

    @property
    def service(self) -> float:
        """Seconds from when it was sent."""
        return self.ended - self.sent

    @property
    def status(self) -> str:
        """The status, or what came instead."""
        return str(self.answer.status) if self.answer else self.failure
