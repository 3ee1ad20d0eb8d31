"""Which chunks that a game has are out of date, what to fetch for them, and what to show together."""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from chunkserver_client.edits import ChunkRange
from chunkserver_client.mesh import ChunkKey


class Refresh(NamedTuple):
    """Chunks to be fetched with `min_revision=revision`, and to be shown all at once: what one edit has cut fits."""

    keys: frozenset[ChunkKey]
    revision: int


_NEVER: Final = -1
"""The revision of a chunk that was not fetched yet."""


class Chunks:
    """The chunks that a game wants, and as of which revision of the world it has them.

    add --> waiting -- take --> fetching -- done --> up to date -- changed --> waiting
    """

    def __init__(self) -> None:
        self._held: dict[ChunkKey, int] = {}
        self._waiting: dict[ChunkKey, Refresh] = {}
        self._fetching: dict[ChunkKey, Refresh] = {}

    @property
    def are_current(self) -> bool:
        """Whether there is nothing to fetch, and nothing is fetched."""
        return not self._waiting and not self._fetching

    def add(self, key: ChunkKey) -> None:
        """Want a chunk from now on. Nothing that changes it is missed, also while it is fetched for the first time."""
        if key not in self._held:
            self._held[key] = _NEVER
            self._wait(Refresh(frozenset((key,)), 0))

    def remove(self, key: ChunkKey) -> None:
        """Want a chunk no more."""
        self._held.pop(key, None)
        self._narrow(key)

    def changed(self, ranges: Iterable[ChunkRange], revision: int) -> None:
        """Note that chunks may have changed at a revision."""
        self._outdate({key for each in ranges for key in each.among(self._held)}, revision)

    def outdate(self, is_outdated: Callable[[ChunkKey], bool], revision: int) -> None:
        """Note that the chunks for which this holds may have changed at a revision."""
        self._outdate(set(filter(is_outdated, self._held)), revision)

    def take(self) -> list[Refresh]:
        """Return what to fetch now. What changes while it is fetched is returned again when it is `done`."""
        ready = [one for one in dict.fromkeys(self._waiting.values()) if one.keys.isdisjoint(self._fetching)]
        for refresh in ready:
            for key in refresh.keys:
                self._fetching[key] = self._waiting.pop(key)
        return ready

    def done(self, refresh: Refresh, revision: int) -> None:
        """Note that all chunks of a refresh have come and are shown. revision: the lowest `World-Revision` of them."""
        for key in self._ended(refresh) & self._held.keys():
            self._held[key] = max(revision, self._held[key])
            waiting = self._waiting.get(key)
            if waiting is not None and waiting.revision <= self._held[key]:
                self._narrow(key)

    def failed(self, refresh: Refresh) -> None:
        """Note that chunks of a refresh have not come: `take` returns them again."""
        self._outdate(self._ended(refresh), refresh.revision)

    def clear(self) -> None:
        """Forget all chunks."""
        for chunks in (self._held, self._waiting, self._fetching):
            chunks.clear()

    def _outdate(self, found: set[ChunkKey], revision: int) -> None:
        keys = {key for key in found if self._held.get(key, revision) < revision}
        for other in {self._waiting[key] for key in keys if key in self._waiting}:
            keys |= other.keys
            revision = max(revision, other.revision)
        self._wait(Refresh(frozenset(keys), revision))

    def _ended(self, refresh: Refresh) -> set[ChunkKey]:
        """Return the chunks that were fetched for this; none if all was forgotten meanwhile."""
        keys = {key for key in refresh.keys if self._fetching.get(key) is refresh}
        for key in keys:
            del self._fetching[key]
        return keys

    def _wait(self, refresh: Refresh) -> None:
        self._waiting.update(dict.fromkeys(refresh.keys, refresh))

    def _narrow(self, key: ChunkKey) -> None:
        refresh = self._waiting.pop(key, None)
        if refresh is not None:
            self._wait(Refresh(refresh.keys - {key}, refresh.revision))
