"""One request and its whole answer: asked for again while that makes sense, out of the cache where that is right."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from chunkserver_client.cache import AnswerCache, Entry
from chunkserver_client.coding import decoded
from chunkserver_client.errors import BadAnswer, Problem, Unavailable, problem
from chunkserver_client.json_tree import Json
from chunkserver_client.retry import Retry, Trial, give_up, retry_after
from chunkserver_client.steps import LOST, NEVER_SENT, Answer, Head, Open, Pause, Read, Request, Steps, Value

BODY_BYTES_MAX: Final = 1 << 26
"""Of an answer, with its coding and without. A chunk of 64 cells whose every cell is full, in floats, has 36 MB."""
JSON_MEDIA_TYPE: Final = "application/json"
PROBLEM_MEDIA_TYPE: Final = "application/problem+json"
SHOWN_BYTES_MAX: Final = 200
REFUSED_STATUSES: Final = (429, 503)
"""With these a server says that it did nothing. A proxy's 502 and 504 leave open what the server behind it did."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """How this client asks: how patiently, and with which cache. read_seconds: of each read."""

    retry: Retry
    cache: AnswerCache
    read_seconds: float

    def ask(self, request: Request, parse: Callable[[Answer], Value], retry: Retry | None = None) -> Steps[Value]:
        """Return what `parse` makes of the answer.

        Asked for again after a 429 or 503; and, if the request is repeatable, after a 502 or 504, when the connection
        was lost, or when `parse` raises `BadAnswer`. What the cache keeps has been parsed once. Raises `Problem` for an
        answer that is an error, `BadAnswer`, and `Unreachable`.
        """
        trial = Trial(retry or self.retry)
        while True:
            entry = self.cache.find(request) if request.cached else None
            if entry is not None and self.cache.is_fresh(entry):
                return parse(entry.answer)
            try:
                answer = yield from self._answer(request, entry, trial)
                value = parse(answer)
            except Unavailable as error:
                if not (request.repeatable or error.status in REFUSED_STATUSES):
                    raise
                pause = trial.pause_after(error)
            except (BadAnswer, *LOST) as error:
                if isinstance(error, BadAnswer):
                    self.cache.drop(request)
                if not (request.repeatable or isinstance(error, NEVER_SENT)):
                    give_up(error)
                pause = trial.pause_after(error)
            else:
                if request.cached:
                    self.cache.keep(request, answer)
                return value
            yield Pause(pause)

    def open(self, request: Request, trial: Trial) -> Generator[Any, Any, Head]:
        """Send `request` and return the head of its answer; no read takes longer than the trial has left."""
        head: Head = yield Open(request, max(0.0, min(self.read_seconds, trial.seconds_left)))
        return head

    def rest(self, head: Head, trial: Trial) -> Steps[Answer]:
        """Read the body to its end. Raises `BadAnswer` if it is too long, or comes too slowly."""
        pieces, size = list[bytes](), 0
        while True:
            piece: bytes = yield Read()
            if not piece:
                # An answer to HEAD, and a 304, may name the coding of a body that is not there.
                coding = head.headers.get("content-encoding", "identity") if pieces else "identity"
                return Answer(head.status, head.headers, decoded(b"".join(pieces), coding, BODY_BYTES_MAX))
            pieces.append(piece)
            size += len(piece)
            if size > BODY_BYTES_MAX:
                raise BadAnswer(f"a body of more than {BODY_BYTES_MAX} bytes")
            if trial.seconds_left < 0:
                raise BadAnswer(f"{size} bytes of a body came, and then the time was up")

    def _answer(self, request: Request, entry: Entry | None, trial: Trial) -> Steps[Answer]:
        """Return the answer of the server, or what the cache has if the server says that it is still right."""
        if entry is not None:
            request = replace(request, headers={**request.headers, "if-none-match": entry.tag})
        head = yield from self.open(request, trial)
        answer = yield from self.rest(head, trial)
        return answer if entry is None or answer.status != 304 else _confirmed(entry, answer)


def _confirmed(entry: Entry, answer: Answer) -> Answer:
    """Return what the cache has, which a 304 says is right. Raises `BadAnswer` if the 304 is about something else."""
    if answer.headers.get("etag") != entry.tag:
        raise BadAnswer(f"a 304 for {answer.headers.get('etag')}: asked for {entry.tag}")
    control = answer.headers.get("cache-control", entry.answer.headers.get("cache-control", ""))
    return replace(entry.answer, headers={**entry.answer.headers, "cache-control": control})


def checked(answer: Answer, *statuses: int) -> Answer:
    """Return `answer` if its status is one of `statuses`. Raises `Problem` for an error, `BadAnswer` for all else."""
    if answer.status in statuses:
        return answer
    if answer.status < 400:
        raise BadAnswer(f"the status is {answer.status}: expected {statuses}")
    raise refusal(answer.status, answer.headers, answer.content)


def refusal(status: int, headers: Mapping[str, str], content: bytes) -> Problem:
    """Return the `Problem` that an answer is; what is no problem+json, a proxy's page say, becomes its `detail`."""
    members: dict[str, Any] = {}
    if media_type(headers) == PROBLEM_MEDIA_TYPE:
        try:
            members = Json.parse(content).members()
        except BadAnswer:
            members = {}
    if not members:
        members = {"title": "no problem+json", "detail": content[:SHOWN_BYTES_MAX].decode("utf-8", "replace")}
    return problem(status, members, retry_after(headers))


def json_of(answer: Answer) -> Json:
    """Return the JSON of an answer. Raises `BadAnswer` if it has another type."""
    if media_type(answer.headers) != JSON_MEDIA_TYPE:
        raise BadAnswer(f"the media type is {media_type(answer.headers)!r}: expected {JSON_MEDIA_TYPE}")
    return Json.parse(answer.content)


def media_type(headers: Mapping[str, str]) -> str:
    """Return the media type in lower case, without parameters; "" if it is not told."""
    return headers.get("content-type", "").partition(";")[0].strip().lower()
