"""What clients have sent and seen of an edited world, and what is wrong with it.

    Sent      an edit: from its first sending to its answer, which may never have come
    Seen      a chunk: from its asking to its answer
    Logged    an edit of the log, as it was read at the end

`faults` yields a line for each promise that is broken. All times are of one clock.

- The log has all that was acknowledged, at its revision, once, and perhaps what was not answered; in an order that
  could have been: none that began after a later one had its answer.
- What an edit made stale is the same in its answer and in the log.
- An answer's tag and its bytes stand for a chunk at a revision, and that for them.
- An answer shows an edit that had reached the chunk and had begun; none that is older than `min_revision`, than what
  was acknowledged or seen before it was asked for.
- One that may be kept for ever is the chunk as of the revision that was asked for; any other may not be kept.
"""

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

from chunkserver.grid import ChunkKey

Point = tuple[int, int, int]


class Range(NamedTuple):
    """Chunks of a level, both ends included."""

    lod: int
    low: Point
    high: Point

    def holds(self, key: ChunkKey) -> bool:
        inside = (low <= at <= high for low, at, high in zip(self.low, key[1:], self.high, strict=True))
        return self.lod == key.lod and all(inside)


class Sent(NamedTuple):
    """An edit. revision, stale: as it was answered; None and infinitely late if it was not."""

    name: int
    begin: float
    end: float = inf
    revision: int | None = None
    stale: tuple[Range, ...] = ()


class Logged(NamedTuple):
    revision: int
    name: int
    stale: tuple[Range, ...]


class Seen(NamedTuple):
    """An answer with a chunk.

    had: the tag that was sent along. pinned: the `revision` that was asked for. world: the world's revision, if it was
    told. digest: of the bytes; None of a 304. kept: whether it may be kept for ever.
    """

    key: ChunkKey
    begin: float
    end: float
    status: int
    tag: str
    revision: int
    world: int | None
    digest: str | None
    had: str | None = None
    min_revision: int = 0
    pinned: int | None = None
    kept: bool = False


@dataclass
class Record:
    sent: list[Sent] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    log: list[Logged] = field(default_factory=list)


class Known:
    """The largest of some numbers by then: (when it was known, number)."""

    def __init__(self, pairs: Iterable[tuple[float, int]]) -> None:
        self._times: list[float] = []
        self._largest: list[int] = []
        for time, number in sorted(pairs):
            self._times.append(time)
            self._largest.append(max(number, self._largest[-1] if self._largest else 0))

    def before(self, time: float) -> int:
        """Return the largest that was known before `time`; 0 if there was none."""
        place = bisect_left(self._times, time)
        return self._largest[place - 1] if place else 0


def reaches(stale: Iterable[Range], key: ChunkKey) -> bool:
    return any(each.holds(key) for each in stale)


def faults(record: Record) -> Iterator[str]:
    """Yield what is wrong."""
    yield from _faults_of_log(record)
    yield from _faults_of_names(record.seen)
    yield from _faults_of_times(record)


def _faults_of_log(record: Record) -> Iterator[str]:
    log, sent = record.log, {each.name: each for each in record.sent}
    if [each.revision for each in log] != list(range(1, len(log) + 1)):
        yield "the log has a hole, or is in no order"
    names = [each.name for each in log]
    if len(set(names)) < len(names):
        yield "the log has an edit twice"
    found = {each.name: each for each in log}
    begun = 0.0
    for each in log:
        if each.name not in sent:
            yield f"the log has edit {each.name}, which nobody has sent"
            continue
        if sent[each.name].end < begun:
            yield f"revision {each.revision} had its answer before an earlier one was sent"
        begun = max(begun, sent[each.name].begin)
    for edit in record.sent:
        logged = found.get(edit.name)
        if edit.revision is not None and (logged is None or logged.revision != edit.revision):
            yield f"edit {edit.name} was acknowledged as {edit.revision}, and the log has not that"
        elif edit.revision is not None and logged is not None and logged.stale != edit.stale:
            yield f"what edit {edit.name} made stale is not what it was told"


def _faults_of_names(seen: Sequence[Seen]) -> Iterator[str]:
    """A tag stands for a chunk at a revision, that for a tag, and both for the same bytes."""
    tags: dict[tuple[ChunkKey, int], str] = {}
    versions: dict[str, tuple[ChunkKey, int]] = {}
    digests: dict[str, str] = {}
    for each in sorted(seen, key=lambda one: one.end):
        version = each.key, each.revision
        if tags.setdefault(version, each.tag) != each.tag:
            yield f"{version} has two tags"
        if versions.setdefault(each.tag, version) != version:
            yield f"{version} has the tag of {versions[each.tag]}"
        if each.status == 304:
            if each.tag != each.had:
                yield f"{version} was not modified, but what the client had is another tag"
        elif digests.setdefault(each.tag, each.digest or "") != each.digest:
            yield f"{version} has other bytes than it had"


def _faults_of_times(record: Record) -> Iterator[str]:
    begins = {each.name: each.begin for each in record.sent}
    began = [begins.get(each.name, inf) for each in record.log]
    acknowledged = Known((each.end, each.revision) for each in record.sent if each.revision is not None)
    world_seen = Known((each.end, each.world) for each in record.seen if each.world is not None)
    by_key: dict[ChunkKey, list[Seen]] = defaultdict(list)
    for each in record.seen:
        by_key[each.key].append(each)
    for key, seen in by_key.items():
        reached = [0, *(each.revision for each in record.log if reaches(each.stale, key))]
        told = ((each.end, each.revision) for each in record.sent if reaches(each.stale, key))
        own = Known((end, revision) for end, revision in told if revision is not None)
        own_seen = Known((each.end, each.revision) for each in seen)
        for each in seen:
            yield from _faults_of_world(each, acknowledged, world_seen, began)
            yield from _faults_of_chunk(each, own, own_seen, reached, began)


def _faults_of_world(each: Seen, acknowledged: Known, seen: Known, began: Sequence[float]) -> Iterator[str]:
    """What is wrong with the revision of the world that an answer tells."""
    if each.world is None:
        return
    what = f"the world's revision {each.world} with {each.key}"
    if each.world < each.revision:
        yield f"{what} is older than the chunk's, {each.revision}"
    if each.world < each.min_revision:
        yield f"{what} is older than was asked for, {each.min_revision}"
    if each.world < acknowledged.before(each.begin):
        yield f"{what} is older than what was acknowledged before, {acknowledged.before(each.begin)}"
    if each.world < seen.before(each.begin):
        yield f"{what} is older than was seen before, {seen.before(each.begin)}"
    if each.world > len(began) or (each.world and began[each.world - 1] > each.end):
        yield f"{what} is of an edit that had not begun"


def _faults_of_chunk(
    each: Seen, own: Known, seen: Known, reached: Sequence[int], began: Sequence[float]
) -> Iterator[str]:
    """What is wrong with the chunk's own revision. reached: by the edits of which revisions it was, 0 first."""
    what = f"revision {each.revision} of {each.key}"
    if each.revision < own.before(each.begin):
        yield f"{what} is older than what was acknowledged before, {own.before(each.begin)}"
    if each.revision < seen.before(each.begin):
        yield f"{what} is older than was seen before, {seen.before(each.begin)}"
    if each.revision < last(reached, each.min_revision):
        yield f"{what} is older than was asked for, {each.min_revision}"
    if each.revision not in reached:
        yield f"{what} is of an edit that has not reached it"
    elif each.revision and began[each.revision - 1] > each.end:
        yield f"{what} is of an edit that had not begun"
    if each.kept is not (each.pinned is not None and each.revision <= each.pinned):
        yield f"{what}, asked for as of {each.pinned}, may {'' if each.kept else 'not '}be kept"
    elif each.kept and each.pinned is not None and each.revision != last(reached, each.pinned):
        yield f"{what}, which may be kept, is not that as of {each.pinned}"


def last(revisions: Sequence[int], most: int) -> int:
    """Return the last of rising revisions, the first of which is 0, that is `most` at most."""
    return revisions[bisect_right(revisions, most) - 1]
