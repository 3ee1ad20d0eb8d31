"""What a store is asked to do, and what has to be in it afterwards: a model of edits that is a few plain lists.

history.step(rng)                 something to do to a store
history.fault_in(store)           what is wrong with a store that should have this history, or ""
history.sent_again(store, rng)    what is wrong with its answers to edits that it has had before, or ""
"""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from chunkserver.errors import ChunkError
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Store
from chunkserver.world import World

WORLDS_MAX = 3
CLIENTS = ("ann", "bob", "eve")
SWEEPS = 3
BODY_BYTES_MAX = 6000
PLANE = WorldRecipe(7, builtin("plane"))

Done = Callable[[], None]
Action = Callable[[Store, Done], None]


@dataclass
class Log:
    """A world's edits from the first one on, which has the revision start + 1; and what its foundation is."""

    world: World
    drafts: list[Draft] = field(default_factory=list)
    start: int = 0
    floor: int = 0
    founded: int = 0
    parts: dict[bytes, bytes] = field(default_factory=dict)

    @property
    def revision(self) -> int:
        return self.start + len(self.drafts)

    @property
    def seqs(self) -> dict[str, int]:
        return {draft.client: draft.seq for draft in self.drafts if draft.client and draft.seq}


@dataclass
class Step:
    """Something to do.

    action: does it, and says when each part of it but the last is acknowledged.
    stages: the history before it, and with each of its parts.
    """

    action: Action
    stages: list["History"]

    def take(self, store: Store, may_be: Callable[[list["History"]], None] = lambda _: None) -> None:
        """Do it. `may_be` is told, whenever that changes, the history that is acknowledged, and the next one."""
        left = self.stages

        def done() -> None:
            nonlocal left
            left = left[1:]
            may_be(left[:2])

        may_be(left[:2])
        self.action(store, done)
        may_be(self.stages[-1:])


@dataclass
class History:
    logs: dict[str, Log] = field(default_factory=dict)
    made: int = 0

    def step(self, rng: np.random.Generator) -> Step:
        after = deepcopy(self)
        after.made += 1
        chance = rng.random()
        if not self.logs or (chance < 0.06 and len(self.logs) < WORLDS_MAX):
            return Step(after._create(), [self, after])
        name = str(rng.choice(sorted(self.logs)))
        if chance < 0.09:
            return Step(after._delete(name), [self, after])
        if chance < 0.24:
            return self._lay(name, rng)
        if chance < 0.40:
            return Step(_sweep, [self])
        return Step(after._append(rng), [self, after])

    def _create(self) -> Action:
        world = World(id=f"w{self.made}", recipe=PLANE, recipe_name="plane", generator="0123")
        self.logs[world.id] = Log(world)
        return lambda store, _: _no(store.catalogue.create(world) is not world)

    def _delete(self, name: str) -> Action:
        del self.logs[name]
        return lambda store, _: _no(store.catalogue.delete(name) is None)

    def _lay(self, name: str, rng: np.random.Generator) -> Step:
        """Return a step that lays a foundation in several, with edits between them, but before the first edit."""
        log = self.logs[name]
        between, after = deepcopy(self), deepcopy(self)
        append: Action = _sweep
        if log.revision:
            between.made += 1
            append = between._append(rng)
            after = deepcopy(between)
        laid = after.logs[name]
        low, high = (max(1, log.founded), log.revision) if log.revision else (1, 9)
        laid.founded = int(rng.integers(low, high + 1))
        laid.floor, laid.start = (log.founded, log.start) if log.revision else (laid.founded, laid.founded)
        laid.parts = {b"%d" % part: rng.bytes(int(rng.integers(3000))) for part in range(int(rng.integers(6)))}

        def parts(store: Store, done: Done) -> Iterator[tuple[bytes, bytes]]:
            for number, part in enumerate(laid.parts.items()):
                if number == 3:
                    append(store, done)
                    done()
                yield part
            if len(laid.parts) <= 3:
                append(store, done)
                done()

        def lay(store: Store, done: Done) -> None:
            store.log.lay(laid.world.epoch, laid.founded, parts(store, done))

        return Step(lay, [self, between, after])

    def _append(self, rng: np.random.Generator) -> Action:
        drafts, revisions = [], []
        for number in range(int(rng.integers(1, 5))):
            log = self.logs[str(rng.choice(sorted(self.logs)))]
            drafts.append(_draft(log, f"{self.made}-{number}", rng))
            log.drafts.append(drafts[-1])
            revisions.append(log.revision)
        return lambda store, _: _no([_revision(one) for one in store.log.append(drafts)] != revisions)

    def fault_in(self, store: Store) -> str:
        """Return what a store lacks of this history, or has beyond it; nothing if it is as it should be."""
        names = [world.id for world in store.catalogue.page("", 100)]
        if names != sorted(self.logs):
            return f"the worlds are {names}, not {sorted(self.logs)}"
        return next((fault for log in self.logs.values() for fault in _faults(log, store)), "")

    def sent_again(self, store: Store, rng: np.random.Generator) -> str:
        """Return what is wrong with the answers to some edits that the store has had before; it writes none again."""
        sent = [(log, int(place)) for log in self.logs.values() for place in rng.integers(len(log.drafts) or 1, size=3)]
        faults = (fault for log, place in sent if log.drafts for fault in _sent_again(log, place, store))
        return next(faults, "")


def _draft(log: Log, name: str, rng: np.random.Generator) -> Draft:
    client = str(rng.choice(CLIENTS)) if rng.random() < 0.7 else None
    return Draft(
        epoch=log.world.epoch,
        digest=name.encode(),
        strokes=rng.bytes(int(rng.integers(BODY_BYTES_MAX))),
        stale=name.encode(),
        client=client,
        seq=log.seqs.get(client, 0) + int(rng.integers(1, 3)) if client else None,
        key=name if rng.random() < 0.3 else None,
    )


def _faults(log: Log, store: Store):
    """Yield what is wrong with the log of one world."""
    epoch, kept = log.world.epoch, store.log
    found = store.catalogue.find(log.world.id)
    if found is None or found.epoch != epoch:
        yield "another world has the id"
    if (kept.revision(epoch), kept.floor(epoch)) != (log.revision, log.floor):
        yield f"floor and revision {kept.floor(epoch)}, {kept.revision(epoch)}, not {log.floor}, {log.revision}"
        return
    revision, parts = kept.foundation(epoch)
    if (revision, dict(parts)) != (log.founded, log.parts):
        yield f"the foundation is not that of revision {log.founded}"
    edits = [(edit.revision, edit.strokes, edit.client, edit.seq) for edit in kept.read(epoch, log.floor)]
    wanted = [(log.start + number, one.strokes, one.client, one.seq) for number, one in enumerate(log.drafts, 1)]
    if edits != wanted[log.floor - log.start :]:
        yield f"edits {[edit[0] for edit in edits]} are not those behind {log.floor}, to {log.revision}"
    for client, seq in log.seqs.items():
        if kept.mark(epoch, client) != seq:
            yield f"the mark of {client} is {kept.mark(epoch, client)}, not {seq}"


def _sent_again(log: Log, place: int, store: Store):
    """What was acknowledged and is sent again is not written again, and gets its answer."""
    draft, revision = log.drafts[place], log.start + place + 1
    if draft.client is None and draft.key is None:
        return
    (outcome,) = store.log.append([draft])
    at_most = log.floor if draft.client and revision <= log.floor else revision
    if isinstance(outcome, ChunkError):
        yield f"revision {revision}, sent again, is refused: {outcome}"
    elif not outcome.duplicate or not min(revision, at_most) <= outcome.revision <= at_most:
        yield f"revision {revision}, sent again, is answered by {outcome}"


def _sweep(store: Store, _: Done) -> None:
    for _step in range(SWEEPS):
        store.log.sweep()


def _revision(outcome: object) -> int | str:
    return getattr(outcome, "revision", repr(outcome))


def _no(wrong: bool) -> None:
    assert not wrong, "the store has answered something else"
