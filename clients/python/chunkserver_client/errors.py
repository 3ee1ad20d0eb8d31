"""Everything that can go wrong, drawn before any code.

ClientError
|-- BadAnswer            what came is not what docs/wire and docs/api.md say
|   `-- BadChunk         bytes that are no chunk: truncated, mutated, of another version
|-- Unreachable          no whole answer came, however often it was asked for
|-- StreamEnded          a stream of edits is over, and why
|-- EditLost             nobody answers this edit of a stream any more
`-- Problem              the server says no, and why
    |-- BadRequest       400, 413, 415, 422: asked for in the wrong way
    |-- NotAllowed       401, 403: an API key is missing, unknown, or too weak
    |-- NotFound         404
    |-- Conflict         409
    |-- Gone             410: the generator or the epoch has changed; read the descriptor again
    `-- Unavailable      429, 502, 503, 504: not now; it was asked for again until the time was up
"""

from collections.abc import Mapping
from typing import Any, Final

PROBLEM_PREFIX: Final = "urn:chunkserver:problem:"

_ENDS: Final = {
    1009: "a frame was too large",
    1011: "this side has failed",
    4400: "a message was malformed",
    4401: "the API key is missing, unknown, or not good any more",
    4403: "this may not be done from here, or with this API key",
    4404: "the world is gone",
    4409: "another connection of the same name has come, or another generator has created the world",
    4412: "a message came out of order",
    4422: "the server does not speak this version of the protocol",
}


class ClientError(Exception):
    """Whatever this package raises on purpose, but for a `ValueError` where it was called in the wrong way."""


class BadAnswer(ClientError):
    """What came is not what the documents say. The message names the place and the value."""


class BadChunk(BadAnswer):
    """Bytes that are no chunk."""


class Unreachable(ClientError):
    """No whole answer came. `__cause__` is the last error of the connection."""


class StreamEnded(ClientError):
    """A stream of edits is over, and another connection would end in the same way.

    code: as docs/wire/edit_v1.md has it; 4000 + the status if the server did not take the connection at all: then
        `__cause__` is the `Problem`.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"the stream has ended with {code}: {_ENDS.get(code, 'this side has closed it')}")
        self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by its code."""
        return type(self), (self.code,)


class EditLost(ClientError):
    """Nobody answers this edit any more: the stream has ended, or the world has begun anew. It may be written or not.

    seq: of the edit.
    """

    def __init__(self, seq: int, why: str) -> None:
        super().__init__(f"edit {seq} was not answered: {why}")
        self.seq = seq
        self.why = why

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by what it was made of."""
        return type(self), (self.seq, self.why)


class Problem(ClientError):
    """An answer that is an error: RFC 9457's members, and the offending values.

    status: of HTTP.
    type, title, detail, instance: of the problem; "about:blank", or "" where it has none.
    values: the problem's further members, under the names of their parameters.
    retry_after: seconds that the server asks to wait; 0 if it does not.
    """

    def __init__(self, status: int, members: Mapping[str, Any], retry_after: float = 0.0) -> None:
        texts = {name: _text(members, name) for name in ("type", "title", "detail", "instance")}
        super().__init__(f"{status} {texts['title']}: {texts['detail']}")
        self.status = status
        self.retry_after = retry_after
        self.type = texts["type"] or "about:blank"
        self.title = texts["title"]
        self.detail = texts["detail"]
        self.instance = texts["instance"]
        self.values = {name: value for name, value in members.items() if name not in {*texts, "status"}}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by its members: an error of a process pool has to come through."""
        members = {"type": self.type, "title": self.title, "detail": self.detail, "instance": self.instance}
        return type(self), (self.status, {**self.values, **members}, self.retry_after)

    @property
    def name(self) -> str:
        """The short name of docs/api.md's table: `bad-key`. Of a problem that is not chunkserver's, the whole type."""
        return self.type.removeprefix(PROBLEM_PREFIX)


class BadRequest(Problem):
    """Asked for in the wrong way: `values` has what is wrong."""


class NotAllowed(Problem):
    """An API key is missing, unknown, or has too small a scope."""


class NotFound(Problem):
    """No such world, recipe, revision or path."""


class Conflict(Problem):
    """A world with other content has this id, or another generator has created it."""


class Gone(Problem):
    """The descriptor is out of date: the generator or the epoch has changed."""


class Unavailable(Problem):
    """Not now, and not later either within the time that `Retry` gives."""


_BY_STATUS: Final[dict[int, type[Problem]]] = {
    **dict.fromkeys((400, 413, 415, 422), BadRequest),
    **dict.fromkeys((401, 403), NotAllowed),
    404: NotFound,
    409: Conflict,
    410: Gone,
    **dict.fromkeys((429, 502, 503, 504), Unavailable),
}


def problem(status: int, members: Mapping[str, Any], retry_after: float = 0.0) -> Problem:
    """Return the `Problem` for an answer: the class that its status has, with what its body says."""
    return _BY_STATUS.get(status, Problem)(status, members, retry_after)


def _text(members: Mapping[str, Any], name: str) -> str:
    found = members.get(name, "")
    return found if isinstance(found, str) else str(found)
