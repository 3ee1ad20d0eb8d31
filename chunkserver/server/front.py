"""What was answered before, answered again in front of the application: chunks out of the cache, and 304s.

    request -> known, and does it hold? -> its headers, and the body out of the cache
                   | no
                   v
               application, which keeps what it has answered

The application parses, validates and refuses; here the same request is looked up as it stands. So nothing is answered
here that the application has not answered once, and whatever changes a request makes it another one.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final, NamedTuple

from fastapi import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from chunkserver.server.cache import ChunkCache
from chunkserver.server.etag import is_known
from chunkserver.server.openapi import RESOURCE

ANSWERS_BYTES_MAX: Final = 32 << 20
"""Room for about 8,000 URLs; the bodies are the cache's."""
ENTRY_BYTES: Final = 4096
"""What an entry costs besides its key: both heads, tag and table slots. An upper bound, held by its unit test."""
KEY_BYTES_MAX: Final = 2048
"""Path, query and `Accept` of a request that is kept."""
VARYING: Final = b"accept"
"""The request header that may change an answer. One more that the application reads has to be part of the key."""
CONDITION: Final = b"if-none-match"
KEPT: Final = (HTTPStatus.OK, HTTPStatus.NO_CONTENT, HTTPStatus.NOT_MODIFIED)

_Headers = tuple[tuple[bytes, bytes], ...]
_Key = tuple[str | bytes, ...]


class Answer(NamedTuple):
    """All of one answer."""

    status: int
    headers: _Headers
    body: bytes


@dataclass(slots=True)
class _Entry:
    """What a URL was answered with, as long as `holds`. A part that nobody asked for yet is without headers."""

    tag: str
    holds: Callable[[], bool]
    not_modified: _Headers = ()
    status: int = 0
    headers: _Headers = ()


class Answers:
    """The heads of answers, by path, query and `Accept`; their bodies are in `cache`. The least recently used go first.

    One event loop owns it; nothing in it is thread-safe.

    bytes: what the kept entries weigh now, at most `bytes_max`.
    """

    def __init__(self, cache: ChunkCache, bytes_max: int = ANSWERS_BYTES_MAX) -> None:
        self.bytes_max = bytes_max
        self.bytes = 0
        self._cache = cache
        self._kept: OrderedDict[_Key, _Entry] = OrderedDict()

    def find(self, scope: Scope) -> Answer | None:
        """Return what the application would answer to this GET or HEAD, or None if that is not known here, or not any
        more. A body counts as a hit of the cache, and as used."""
        key, if_none_match = _asked(scope)
        entry = self._kept.get(key)
        if entry is None or not entry.holds():
            return None
        self._kept.move_to_end(key)
        if if_none_match and is_known(if_none_match, entry.tag):
            return Answer(HTTPStatus.NOT_MODIFIED, entry.not_modified, b"") if entry.not_modified else None
        chunk = self._cache.find(entry.tag) if entry.headers else None
        if chunk is None:
            return None
        return Answer(entry.status, entry.headers, chunk.body if entry.status == HTTPStatus.OK else b"")

    def keep(self, scope: Scope, tag: str, response: Response, holds: Callable[[], bool]) -> None:
        """Keep the head of `response`, whose body is in the cache under `tag`, as long as `holds` returns true.

        `holds` is asked before each answer. It tells whether the application would answer the same request alike.
        """
        key, _ = _asked(scope)
        if response.status_code not in KEPT or _key_bytes(key) > KEY_BYTES_MAX or not holds():
            return
        entry = self._kept.get(key)
        if entry is None:
            self.bytes += _weight(key)
        if entry is None or not entry.holds():
            entry = self._kept[key] = _Entry(tag, holds)
        if response.status_code == HTTPStatus.NOT_MODIFIED:
            entry.not_modified = tuple(response.raw_headers)
        else:
            entry.status, entry.headers = response.status_code, tuple(response.raw_headers)
        while self.bytes > self.bytes_max:
            oldest, _ = self._kept.popitem(last=False)
            self.bytes -= _weight(oldest)


class Front:
    """ASGI: answers what `answers` knows, and hands on everything else as it came."""

    def __init__(self, app: ASGIApp, answers: Answers) -> None:
        self._app = app
        self._answers = answers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or let the application do it."""
        known = self._answers.find(scope) if scope["type"] == "http" and scope["method"] in RESOURCE else None
        if known is None:
            await self._app(scope, receive, send)
            return
        await send({"type": "http.response.start", "status": known.status, "headers": known.headers})
        await send({"type": "http.response.body", "body": known.body})


def _asked(scope: Scope) -> tuple[_Key, list[str]]:
    """Return all of a request that can change its answer: what names it, and its `If-None-Match` fields."""
    key: list[str | bytes] = [scope["path"], scope["query_string"]]
    if_none_match = []
    for name, value in scope["headers"]:
        if name == VARYING:
            key.append(value)
        elif name == CONDITION:
            if_none_match.append(value.decode("latin-1"))
    return tuple(key), if_none_match


def _key_bytes(key: Iterable[str | bytes]) -> int:
    """Return what the parts weigh: four bytes a character at most, and the object of each."""
    return sum(64 + len(part) * (4 if isinstance(part, str) else 1) for part in key)


def _weight(key: _Key) -> int:
    return _key_bytes(key) + ENTRY_BYTES
