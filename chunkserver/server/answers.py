"""What was answered before, by the request as it stands: path, query and the header fields that an answer depends on.

    a request that was answered          -> its head, and the body out of the cache
    one that differs in its coordinates  -> the plan that answers it too

Nothing here parses, validates or refuses: that was done when the first of its kind was answered.
"""

import re
from collections import OrderedDict
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final, NamedTuple

from starlette.types import Message, Scope

from chunkserver.grid import ChunkKey
from chunkserver.server.cache import ChunkCache, Kept
from chunkserver.server.cors import Cors
from chunkserver.server.etag import is_known
from chunkserver.server.plan import Plan, Reply, Version

ANSWERS_BYTES_MAX: Final = 32 << 20
"""Room for about 8,000 URLs; the bodies are the cache's."""
ENTRY_BYTES: Final = 4096
"""What an entry costs besides its key: both heads, tag and table slots. An upper bound, held by its unit test."""
PLANS_MAX: Final = 8192
"""Kinds of requests that are known: a world, a format, parameters with a mask (a cut of levels has up to 27), and what
the client accepts."""
KEY_BYTES_MAX: Final = 2048
"""Path, query and header fields of a request that is kept."""

_COORDINATE: Final = "(0|-?[1-9][0-9]{0,18})"
_PLACE: Final = re.compile(rf"(.+/chunks)/{'/'.join([_COORDINATE] * 4)}((?:\.[a-z]+)?)", re.ASCII | re.DOTALL)
"""A chunk's path: what stands before its coordinates, these in their one spelling, and the extension."""

_Key = tuple[str, bytes, bytes | None, bytes | None, bytes | None]


class Asked(NamedTuple):
    """All of a GET or HEAD that can change its answer.

    key: path, query, `Accept`, `Accept-Encoding`, `Origin`. One more field that the application reads has to be added,
    here and in `Answers.find`.
    known: its `If-None-Match`.
    """

    key: _Key
    known: bytes | None

    @property
    def origin(self) -> bytes | None:
        """The site of the page that asks, if a page does."""
        return self.key[-1]

    def knows(self, tag: str) -> bool:
        """Return whether the client has the bytes named `tag`."""
        return self.known is not None and is_known((self.known.decode("latin-1"),), tag)


def asked(scope: Scope) -> Asked | None:
    """Return what a request asks; None if it has a header field twice: only the application reads those."""
    fields = dict(scope["headers"])
    if len(fields) != len(scope["headers"]):
        return None
    get = fields.get
    key = (scope["path"], scope["query_string"], get(b"accept"), get(b"accept-encoding"), get(b"origin"))
    return Asked(key, get(b"if-none-match"))


@dataclass(slots=True)
class _Entry:
    """What a request was answered with. Of both heads only what was sent once is there."""

    plan: Plan
    age: int
    version: Version
    quoted: bytes
    found: Message | None = None
    has_body: bool = False
    kept: Kept | None = None
    not_modified: Message | None = None
    used: bool = False


class Answers:
    """Heads of answers by request, and plans by kind of request; bodies are in `cache`.

    One event loop owns it; nothing in it is thread-safe. What was not used for long goes first. A use is a mark and no
    change of order: beside a body of 60 KB it is memory that is not in the processor's caches that costs.

    bytes: what the kept entries weigh now, at most `bytes_max`.
    hits, not_modified: answers given from here. built: chunks that the front asked of the cache or the workers;
    refused: those of them that were refused.
    """

    def __init__(self, cache: ChunkCache, cors: Cors, bytes_max: int = ANSWERS_BYTES_MAX) -> None:
        self.bytes_max = bytes_max
        self.bytes = 0
        self.hits = 0
        self.not_modified = 0
        self.built = 0
        self.refused = 0
        self._cache = cache
        self._cors = cors
        self._kept: OrderedDict[_Key, _Entry] = OrderedDict()
        self._plans: OrderedDict[tuple[str | bytes | None, ...], Plan] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def find(self, scope: Scope) -> tuple[Message, bytes] | None:
        """Return the head and the body that the application would answer to this GET or HEAD, if they are known here.

        A body counts as a hit of the cache, and as used. This is what most requests cost: it is written for that.
        """
        fields = dict(scope["headers"])
        get = fields.get
        entry = self._kept.get(
            (scope["path"], scope["query_string"], get(b"accept"), get(b"accept-encoding"), get(b"origin"))
        )
        if entry is None or len(fields) != len(scope["headers"]) or not _stands(entry):
            return None
        entry.used = True
        known = get(b"if-none-match")
        if known is not None and (known == entry.quoted or is_known((known.decode("latin-1"),), entry.version.tag)):
            self.not_modified += 1
            if entry.not_modified is None:
                entry.not_modified = self.start(get(b"origin"), entry.plan.not_modified(entry.version))
            return entry.not_modified, b""
        chunk = entry.kept and self._cache.use(entry.kept)
        if not chunk:
            entry.kept = self._cache.look_up(entry.version.tag)  # it may have been dropped, and built again
            chunk = entry.kept and self._cache.use(entry.kept)
        if not (entry.found and chunk):
            return None
        self.hits += 1
        return entry.found, chunk.body if entry.has_body else b""

    def plan(self, wanted: Asked) -> tuple[Plan, ChunkKey] | None:
        """Return how the application would answer, and the chunk; None if no such request was answered before."""
        place = _PLACE.fullmatch(wanted.key[0])
        if place is None:
            return None
        kind = place[1], place[6], *wanted.key[1:]
        plan = self._plans.get(kind)
        if plan is None or not plan.holds():
            return None
        self._plans.move_to_end(kind)
        return plan, ChunkKey(*map(int, place.group(2, 3, 4, 5)))

    def learn(self, wanted: Asked, plan: Plan) -> None:
        """Answer by `plan` what differs from a request that was found good in its coordinates alone."""
        place = _PLACE.fullmatch(wanted.key[0])
        if place is None or _bytes(wanted.key) > KEY_BYTES_MAX:
            return
        self._plans[place[1], place[6], *wanted.key[1:]] = plan
        if len(self._plans) > PLANS_MAX:
            self._plans.popitem(last=False)

    def keep(self, wanted: Asked, plan: Plan, reply: Reply) -> None:
        """Keep the head of `reply`, which `plan` has just made, as long as that holds and is of the same age.

        The body is in the cache, under the tag. A reply that shows no version of a chunk is not kept, nor one whose
        chunk was edited while it was built.
        """
        weight, version = _bytes(wanted.key), reply.version
        if version is None or weight > KEY_BYTES_MAX or not (plan.holds() and plan.is_current(version)):
            return
        entry = self._kept.get(wanted.key)
        if entry is None:
            self._make_room(weight + ENTRY_BYTES)
        if entry is None or entry.plan is not plan or not _stands(entry):
            entry = self._kept[wanted.key] = _Entry(plan, plan.age(), version, b'"%b"' % version.tag.encode())
        if reply.status != HTTPStatus.NOT_MODIFIED:
            entry.found, entry.has_body = self.start(wanted.origin, reply), reply.status == HTTPStatus.OK

    def _make_room(self, weight: int) -> None:
        """Drop the oldest; what was used since it was the oldest last time has a second chance."""
        self.bytes += weight
        while self.bytes > self.bytes_max and self._kept:
            key, entry = self._kept.popitem(last=False)
            if entry.used:
                entry.used = False
                self._kept[key] = entry
            else:
                self.bytes -= _bytes(key) + ENTRY_BYTES

    def start(self, origin: bytes | None, reply: Reply) -> Message:
        """Return the ASGI message that begins `reply` to a page of `origin`, or to a client that is no page."""
        headers = (*reply.headers, *self._cors.headers(origin))
        return {"type": "http.response.start", "status": int(reply.status), "headers": headers}


def _stands(entry: _Entry) -> bool:
    """Return whether the same request would be answered with the same head now."""
    return entry.plan.holds() and entry.age == entry.plan.age()


def _bytes(key: _Key) -> int:
    """Return what a key weighs: four bytes a character at most, and the object of each part."""
    return 64 * len(key) + 4 * len(key[0]) + sum(len(part) for part in key[1:] if part is not None)
