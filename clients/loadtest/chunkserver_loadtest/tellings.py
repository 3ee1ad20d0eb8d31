"""The books of a crowd: which edit has to be told to whom, who has been told, and who was not. No socket, no clock.

An edit is owed to a listener if it may have changed a chunk where that listener looks, and if its revision is in none
of the spans that the listener was left out of: those before it came, what `stale` and `resync` stand for, and all
behind what was known when it was lost.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

FAR: Final = 1 << 40
LOD_MAX: Final = 20
FOREVER: Final = 1 << 62
"""A revision behind all others."""
SPANS_MAX: Final = 64
"""Of a listener; beyond that, the two oldest become one, and what lies between them is not owed any more."""
OPEN_MAX: Final = 100_000
"""Edits that somebody waits for. One more, and the oldest is judged as if all were over."""
SETTLED_MAX: Final = 100_000
"""Revisions that are over, and remembered: who is told of them without need does no harm."""

Place = tuple[int, int, int]
Strokes = list[dict[str, Any]]
"""As docs/edits/strokes.md has them."""


class Look(NamedTuple):
    """Where a listener looks: a box of voxels, both ends included. lod: the coarsest level that it shows there."""

    low: Place
    high: Place
    lod: int = LOD_MAX

    def written(self) -> Mapping[str, Any]:
        """Return it as JSON's values."""
        return {"min": self.low, "max": self.high, "lod": self.lod}

    def meets(self, stale: Iterable[Mapping[str, Any]], cells: int) -> bool:
        """Return whether an edit is told here. stale: the ranges of chunks that it was answered with."""
        return any(each["lod"] <= self.lod and self._meets(each, cells << each["lod"]) for each in stale)

    def _meets(self, chunks: Mapping[str, Any], side: int) -> bool:
        places = zip(chunks["min"], chunks["max"], self.low, self.high, strict=True)
        return all(low * side <= last and first <= (high + 1) * side for low, high, first, last in places)


EVERYWHERE: Final = Look((-FAR,) * 3, (FAR,) * 3)


@dataclass(slots=True, eq=False)
class Sent:
    """An edit. Times are of `time.perf_counter`, 0.0 for what has not been.

    status: 200, or of the problem with which it was refused; 0 without an answer. refusal: the type of that problem.
    revision: 0 if it has none. tellings: when each listener who was owed it got it. is_aside: it is in no figure.
    """

    due: float
    strokes: Strokes
    sent: float = 0.0
    answered: float = 0.0
    status: int = 0
    refusal: str = ""
    revision: int = 0
    tellings: list[float] = field(default_factory=list)
    is_aside: bool = False

    @property
    def told(self) -> int:
        """How many listeners have it."""
        return len(self.tellings)

    @property
    def told_at(self) -> float:
        """When the last of them got it."""
        return max(self.tellings, default=0.0)


@dataclass(slots=True, eq=False)
class Listener:
    """Who is told. known: up to which revision. left_out: spans (after, until] of revisions that are not owed."""

    number: int
    group: int
    known: int
    left_out: list[tuple[int, int]]

    @property
    def is_lost(self) -> bool:
        """Whether it will never be told again."""
        return self.left_out[-1][1] == FOREVER

    def is_owed(self, revision: int) -> bool:
        """Return whether it has to be told of an edit where it looks."""
        return not any(after < revision <= until for after, until in self.left_out)


class Verdict(NamedTuple):
    """What was not as it has to be: how many tellings, or edits.

    missed: listeners know of later edits, and were not told. late: they do not know of later ones either.
    strange: edits that were told, and that nobody of the crowd was answered for.
    changed: edits that were told otherwise than they were sent.
    """

    missed: int
    late: int
    strange: int
    changed: int


@dataclass(slots=True)
class _Edit:
    """An edit that is not settled. sent: None before its answer; until then `early` has who was told, `content` what.

    groups: which are owed it. crowd: how many listeners there were when it was answered. wanted: how many of them.
    """

    sent: Sent | None = None
    early: list[tuple[Listener, float]] = field(default_factory=list)
    content: Strokes | None = None
    groups: frozenset[int] = frozenset()
    crowd: int = 0
    wanted: int = 0

    def counts(self, listener: Listener) -> bool:
        return listener.number < self.crowd and listener.group in self.groups


class Tellings:
    """All books. cells: of a chunk's side. told: called with an edit when all who were owed it have it, if any were."""

    def __init__(self, cells: int, told: Callable[[Sent], None]) -> None:
        self.listeners: list[Listener] = []
        self._cells, self._told = cells, told
        self._looks: dict[Look, int] = {}
        self._sizes: list[int] = []
        self._edits: dict[int, _Edit] = {}
        self._settled: dict[int, None] = {}
        self._since = self._answered = 0
        self._odd: set[Listener] = set()
        self._judged = Verdict(0, 0, 0, 0)

    @property
    def unsettled(self) -> int:
        """How many edits are not answered, or are owed to somebody."""
        return len(self._edits)

    @property
    def is_over(self) -> bool:
        """Whether nobody can be told any more of what was answered: everybody knows of all of it."""
        return all(each.is_lost or each.known >= self._answered for each in self.listeners)

    def join(self, look: Look, known: int) -> Listener:
        """Enter a listener, who knows of everything up to a revision."""
        group = self._looks.setdefault(look, len(self._looks))
        if group == len(self._sizes):
            self._sizes.append(0)
        self._sizes[group] += 1
        listener = Listener(len(self.listeners), group, known, [(-1, known)])
        self.listeners.append(listener)
        self._since = max(self._since, known)
        return listener

    def tell(self, listener: Listener, revisions: Sequence[int], known: int, moment: float) -> None:
        """Note that somebody was told of edits, and of all up to `known` with that."""
        listener.known = known
        for revision in revisions:
            edit = self._edits.get(revision)
            if edit is None:
                if revision in self._settled:
                    continue
                edit = self._open(revision)
            if edit.sent is None:
                edit.early.append((listener, moment))
            elif edit.counts(listener):
                edit.sent.tellings.append(moment)
                self._settle(revision, edit, edit.sent)

    def content(self, revision: int, strokes: Strokes) -> None:
        """Take what an edit is told as, before `tell` says to whom; once for a message, however many get it."""
        edit = self._edits.get(revision)
        if edit is None and revision not in self._settled:
            edit = self._open(revision)
        if edit is not None:
            edit.content = strokes
            self._compare(edit)

    def leave_out(self, listener: Listener, until: int) -> None:
        """Note that somebody is not told of what lies behind what it knows, up to a revision, which it knows now."""
        span = listener.known, until
        listener.known = max(listener.known, until if until < FOREVER else 0)
        listener.left_out.append(span)
        if len(listener.left_out) > SPANS_MAX:
            first, second = listener.left_out[:2]
            listener.left_out[:2] = [(first[0], second[1])]
        self._odd.add(listener)
        for revision, edit in tuple(self._edits.items()):
            if edit.sent is not None and span[0] < revision <= until and edit.counts(listener):
                edit.wanted -= 1
                self._settle(revision, edit, edit.sent)

    def lose(self, listener: Listener) -> None:
        """Note that somebody is told nothing more."""
        self.leave_out(listener, FOREVER)

    def answer(self, sent: Sent, stale: Sequence[Mapping[str, Any]] | None) -> None:
        """Enter an edit that was written. stale: of its answer; of one without it nothing can be told."""
        self._answered = max(self._answered, sent.revision)
        edit = self._edits.get(sent.revision) or self._open(sent.revision)
        edit.sent, edit.crowd = sent, len(self.listeners)
        self._compare(edit)
        looks = self._looks.items() if stale else ()
        edit.groups = frozenset(group for look, group in looks if look.meets(stale or (), self._cells))
        edit.wanted = sum(self._sizes[group] for group in edit.groups)
        odd = self.listeners if sent.revision <= self._since else self._odd
        edit.wanted -= sum(edit.counts(each) and not each.is_owed(sent.revision) for each in odd)
        early, edit.early = edit.early, []
        sent.tellings += [moment for listener, moment in early if edit.counts(listener)]
        self._settle(sent.revision, edit, sent)

    def verdict(self) -> Verdict:
        """Return what is wrong now, if nothing more comes."""
        found = [self._judged, *(self._judge(revision, edit) for revision, edit in self._edits.items())]
        return Verdict(*(sum(each) for each in zip(*found, strict=True)))

    def _compare(self, edit: _Edit) -> None:
        if edit.sent is not None and edit.content is not None:
            changed = edit.content != edit.sent.strokes
            self._judged = self._judged._replace(changed=self._judged.changed + changed)
            edit.content = None

    def _judge(self, revision: int, edit: _Edit) -> Verdict:
        if edit.sent is None:
            return Verdict(0, 0, 1, 0)
        knowing = sum(
            edit.counts(each) and each.known >= revision and each.is_owed(revision) for each in self.listeners
        )
        missed = max(0, knowing - edit.sent.told)
        return Verdict(missed, edit.wanted - edit.sent.told - missed, 0, 0)

    def _open(self, revision: int) -> _Edit:
        edit = self._edits[revision] = _Edit()
        if len(self._edits) > OPEN_MAX:
            oldest = next(iter(self._edits))
            judged = zip(self._judged, self._judge(oldest, self._edits.pop(oldest)), strict=True)
            self._judged = Verdict(*(before + more for before, more in judged))
        return edit

    def _settle(self, revision: int, edit: _Edit, sent: Sent) -> None:
        if sent.told < edit.wanted:
            return
        del self._edits[revision]
        self._settled[revision] = None
        if len(self._settled) > SETTLED_MAX:
            del self._settled[next(iter(self._settled))]
        if sent.tellings:
            self._told(sent)
