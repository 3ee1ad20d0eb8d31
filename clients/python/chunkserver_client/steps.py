"""What a call does, step by step, without doing it: a call is a generator that yields steps and is sent the replies.

    call     --Open(request)-->  driver      <--Head--
             --Read()-------->               <--bytes, b"" at the end--
             --Pause(seconds)->              <--None--
             --Deliver(value)->              what the caller is given while the call goes on

So every call is written once. Two drivers take the steps, with blocking sockets or on the event loop: `driving.py`.
What breaks on the way (`LOST`) is thrown into the generator where it waits for the reply.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import httpx2

Value = TypeVar("Value")

LOST: Final = (httpx2.TransportError, httpx2.DecodingError)
"""No whole answer: the connection failed, broke off, took too long, or what came is not HTTP."""
NEVER_SENT: Final = (httpx2.ConnectError, httpx2.ConnectTimeout, httpx2.PoolTimeout)
"""Those of them after which the server has not seen the request."""


@dataclass(frozen=True, slots=True)
class Request:
    """One HTTP request.

    url: path and query.
    headers: beside those that every request has.
    body: JSON, or nothing.
    repeatable: whether to ask again when nobody knows what the server did.
    cached: whether the answer may be kept.
    """

    method: str
    url: str
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""
    repeatable: bool = True
    cached: bool = False


@dataclass(frozen=True, slots=True)
class Head:
    """Status and headers of an answer, the names in lower case."""

    status: int
    headers: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Answer(Head):
    """A whole answer. content: without its content coding."""

    content: bytes


@dataclass(frozen=True, slots=True)
class Open:
    """Send a request and read the head of its answer. What was open before is closed. timeout_seconds: of each read."""

    request: Request
    timeout_seconds: float


@dataclass(frozen=True, slots=True)
class Read:
    """Read some more of the body, in its content coding."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Deliver:
    """Give the caller a value, and go on when the caller wants the next."""

    value: Any


Step = Open | Read | Pause | Deliver
Steps = Generator[Step, Any, Value]
"""Each step is answered by what its picture says; the driver and the call agree on it, the type cannot."""
