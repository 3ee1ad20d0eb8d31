"""What a store is asked to do, and what has to be in it afterwards: a model of edits that is a few plain lists.

history.step(rng)                 something to do to a store, and the history once that is done
history.fault_in(store)           what is wrong with a store that should have this history, or ""
history.sent_again(store, rng)    what is wrong with its answers to edits that it has had before, or ""
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from chunkserver.errors import ChunkError
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Store
from chunkserver.world import World

WORLDS_MAX = 3
CLIENTS = ("ann", "bob", "eve")
BODY_BYTES_MAX = 6000
PLANE = WorldRecipe(7, builtin("plane"))

Action = Callable[[Store], None]


@dataclass
class Log:
    """A world's edits, from the first on, and how many of them are in its foundation."""

    world: World
    drafts: list[Draft] = field(default_factory=list)
    floor: int = 0
    parts: dict[bytes, bytes] = field(default_factory=dict)

    @property
    def seqs(self) -> dict[str, int]:
        return {draft.client: draft.seq for draft in self.drafts if draft.client and draft.seq}


@dataclass
class History:
    logs: dict[str, Log] = field(default_factory=dict)
    made: int = 0

    def step(self, rng: np.random.Generator) -> tuple[Action, "History"]:
        after = deepcopy(self)
        after.made += 1
        chance = rng.random()
        if not self.logs or (chance < 0.06 and len(self.logs) < WORLDS_MAX):
            return after._create(), after
        name = str(rng.choice(sorted(self.logs)))
        if chance < 0.09:
            return after._delete(name), after
        if chance < 0.20:
            return after._compact(name, rng), after
        return after._append(rng), after

    def _create(self) -> Action:
        world = World(id=f"w{self.made}", recipe=PLANE, recipe_name="plane", generator="0123")
        self.logs[world.id] = Log(world)
        return lambda store: _no(store.catalogue.create(world) is not world)

    def _delete(self, name: str) -> Action:
        del self.logs[name]
        return lambda store: _no(store.catalogue.delete(name) is None)

    def _compact(self, name: str, rng: np.random.Generator) -> Action:
        log = self.logs[name]
        log.floor = int(rng.integers(log.floor, len(log.drafts) + 1))
        log.parts = {b"%d" % part: rng.bytes(int(rng.integers(3000))) for part in range(int(rng.integers(4)))}
        return lambda store: store.log.compact(log.world.epoch, log.floor, log.parts.items())

    def _append(self, rng: np.random.Generator) -> Action:
        drafts, revisions = [], []
        for number in range(int(rng.integers(1, 5))):
            log = self.logs[str(rng.choice(sorted(self.logs)))]
            drafts.append(_draft(log, f"{self.made}-{number}", rng))
            log.drafts.append(drafts[-1])
            revisions.append(len(log.drafts))
        return lambda store: _no([_revision(one) for one in store.log.append(drafts)] != revisions)

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
    if kept.revision(epoch) != len(log.drafts):
        yield f"revision {kept.revision(epoch)}, not {len(log.drafts)}"
    if kept.foundation(epoch) != (log.floor, log.parts):
        yield f"the foundation is not that of floor {log.floor}"
    edits = [(edit.revision, edit.strokes, edit.client, edit.seq) for edit in kept.read(epoch, log.floor)]
    wanted = [(number + 1, draft.strokes, draft.client, draft.seq) for number, draft in enumerate(log.drafts)]
    if edits != wanted[log.floor :]:
        yield f"edits {[edit[0] for edit in edits]} are not those behind {log.floor}, to {len(log.drafts)}"
    for client, seq in log.seqs.items():
        if kept.mark(epoch, client) != seq:
            yield f"the mark of {client} is {kept.mark(epoch, client)}, not {seq}"


def _sent_again(log: Log, place: int, store: Store):
    """What was acknowledged and is sent again is not written again, and gets its answer."""
    draft, revision = log.drafts[place], place + 1
    if draft.client is None and draft.key is None:
        return
    (outcome,) = store.log.append([draft])
    at_most = log.floor if draft.client and revision <= log.floor else revision
    if isinstance(outcome, ChunkError):
        yield f"revision {revision}, sent again, is refused: {outcome}"
    elif not outcome.duplicate or not min(revision, at_most) <= outcome.revision <= at_most:
        yield f"revision {revision}, sent again, is answered by {outcome}"


def _revision(outcome: object) -> int | str:
    return getattr(outcome, "revision", repr(outcome))


def _no(wrong: bool) -> None:
    assert not wrong, "the store has answered something else"
