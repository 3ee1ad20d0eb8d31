"""Answers that were given before: kept as long as there is room, and used only if they are still right.

An entry is found by its URL and its `Accept`, the coding being the same for the whole client. It is used without asking
while its `Cache-Control` allows that; after that its tag goes into `If-None-Match`, and a 304 has to name the same tag.
"""

import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from chunkserver_client.steps import Answer, Request

ENTRY_BYTES: Final = 1 << 10
"""Counted for the head of each entry, so that a cache of empty chunks is bounded as well."""
MAX_AGE_DIGITS_MAX: Final = 10

_MAX_AGE: Final = re.compile(rf"\bmax-age=(\d{{1,{MAX_AGE_DIGITS_MAX}}})(?:\s*,|\s*$)")


class Name(NamedTuple):
    """What finds an entry."""

    url: str
    accept: str


@dataclass(frozen=True, slots=True)
class Entry:
    """A kept answer. fresh_until: of the cache's clock; until then it is used without asking."""

    answer: Answer
    fresh_until: float

    @property
    def tag(self) -> str:
        """The entity tag as the header has it, with its quotes."""
        return self.answer.headers["etag"]

    @property
    def bytes(self) -> int:
        """What it counts for."""
        return ENTRY_BYTES + len(self.answer.content)


class AnswerCache:
    """At most `bytes_max` bytes of answers; the least recently used goes first. For any number of threads."""

    def __init__(self, bytes_max: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._bytes_max = bytes_max
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: OrderedDict[Name, Entry] = OrderedDict()
        self._bytes = 0

    @property
    def bytes(self) -> int:
        """How much it holds by now."""
        return self._bytes

    def find(self, request: Request) -> Entry | None:
        """Return what was answered to `request`; it may be out of date."""
        with self._lock:
            entry = self._entries.get(_name(request))
            if entry is not None:
                self._entries.move_to_end(_name(request))
            return entry

    def is_fresh(self, entry: Entry) -> bool:
        """Return whether `entry` may be used without asking."""
        return self._clock() < entry.fresh_until

    def keep(self, request: Request, answer: Answer) -> None:
        """Keep an answer, if it has a strong tag and does not forbid it; what is there already is replaced."""
        control = answer.headers.get("cache-control", "")
        tag = answer.headers.get("etag", "")
        if "no-store" in control or not tag.startswith('"'):
            self.drop(request)
            return
        entry = Entry(answer, self._clock() + _fresh_seconds(control))
        with self._lock:
            self._remove(_name(request))
            if entry.bytes <= self._bytes_max:
                self._entries[_name(request)] = entry
                self._bytes += entry.bytes
            while self._bytes > self._bytes_max:
                self._remove(next(iter(self._entries)))

    def drop(self, request: Request) -> None:
        """Forget what was answered to `request`."""
        with self._lock:
            self._remove(_name(request))

    def drop_where(self, is_old: Callable[[str, Answer], bool]) -> None:
        """Forget the answers for which `is_old`, given their URL and themselves, is true."""
        with self._lock:
            for name in [name for name, entry in self._entries.items() if is_old(name.url, entry.answer)]:
                self._remove(name)

    def _remove(self, name: Name) -> None:
        removed = self._entries.pop(name, None)
        if removed is not None:
            self._bytes -= removed.bytes


def _name(request: Request) -> Name:
    return Name(request.url, request.headers.get("accept", ""))


def _fresh_seconds(control: str) -> float:
    """Return the seconds of `max-age`; 0 with `no-cache`, or without any."""
    found = _MAX_AGE.search(control)
    return 0.0 if found is None or "no-cache" in control else float(found[1])


def head_of(tag: str, content: str, revision: int, *, immutable: bool) -> Mapping[str, str]:
    """Return the headers that a chunk of a batch would have had, had it been asked for alone."""
    return {
        "etag": f'"{tag}"' if tag else "",
        "cache-control": "max-age=31536000, immutable" if immutable else "no-cache",
        "chunk-content": content,
        "chunk-revision": str(revision),
    }
