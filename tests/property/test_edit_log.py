"""The log beside a model of it that is a few dictionaries: whatever is done in whatever order, they agree."""

import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from chunkserver.errors import BadParameter, StoreFull, WorldGone
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Outcome, Store, log
from chunkserver.world import World
from tests.fault.disk import Disk
from tests.scale import count

KEYS_MAX = 3
CLIENTS_MAX = 2
NAMES = st.sampled_from("ab")
CLIENTS = st.sampled_from([None, "ann", "bob", "eve"])
KEYS = st.sampled_from([None, None, "k", "l", "m", "n", "o"])
BODIES = st.sampled_from([b"", b"1", b"2", b"3"])


@dataclass
class Modelled:
    """What is known of one world. Revision r is edits[r - 1]."""

    epoch: str
    edits: list[Draft] = field(default_factory=list)
    floor: int = 0
    parts: dict[bytes, bytes] = field(default_factory=dict)

    def expected(self, draft: Draft) -> Outcome | type[Exception]:
        """Return what a log has to answer, and take the draft in if it is new."""
        for revision, edit in self.keyed():
            if draft.key == edit.key:
                return self._again(draft, edit, revision)
        if draft.client is not None:
            mine = [(number + 1, edit) for number, edit in enumerate(self.edits) if edit.client == draft.client]
            folded = [revision for revision, _ in mine if revision <= self.floor]
            for revision, edit in mine:
                if edit.seq == draft.seq and revision > self.floor:
                    return self._again(draft, edit, revision)
            if folded and (draft.seq or 0) <= (self.edits[folded[-1] - 1].seq or 0):
                return Outcome(folded[-1], b"", duplicate=True)
            if mine and (draft.seq or 0) < (mine[-1][1].seq or 0):
                return BadParameter
        known = {edit.client for edit in self.edits} - {None}
        if draft.client not in (None, *known) and len(known) >= CLIENTS_MAX:
            return StoreFull
        self.edits.append(draft)
        return Outcome(len(self.edits), draft.stale)

    def keyed(self) -> list[tuple[int, Draft]]:
        return [(number + 1, edit) for number, edit in enumerate(self.edits) if edit.key is not None][-KEYS_MAX:]

    def _again(self, draft: Draft, edit: Draft, revision: int) -> Outcome | type[Exception]:
        if draft.digest != edit.digest:
            return BadParameter
        return Outcome(revision, edit.stale, duplicate=True)


class LogMachine(RuleBasedStateMachine):
    """A store in a folder, which is closed and opened now and then, and what should be in it."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.disk = Disk()  # it does not sync: here nobody pulls the plug
        self.limits = [mock.patch.object(log, "KEYS_MAX", KEYS_MAX), mock.patch.object(log, "CLIENTS_MAX", CLIENTS_MAX)]
        for limit in self.limits:
            limit.start()
        self.worlds: dict[str, Modelled] = {}
        self.gone: list[str] = []

    @initialize()
    def open(self) -> None:
        self.store = Store(self.folder)

    def teardown(self) -> None:
        self.store.close()
        self.disk.unregister()
        for limit in self.limits:
            limit.stop()
        shutil.rmtree(self.folder)

    @rule()
    def restart(self) -> None:
        self.store.close()
        self.open()

    @rule(name=NAMES)
    def create(self, name: str) -> None:
        world = World(id=name, recipe=WorldRecipe(7, builtin("plane")), recipe_name="plane", generator="0123")
        self.worlds.setdefault(name, Modelled(world.epoch))
        assert self.store.catalogue.create(world).epoch == self.worlds[name].epoch

    @precondition(lambda self: self.worlds)
    @rule(name=NAMES)
    def delete(self, name: str) -> None:
        modelled = self.worlds.pop(name, None)
        assert bool(self.store.catalogue.delete(name)) is bool(modelled)
        if modelled:
            self.gone.append(modelled.epoch)

    @precondition(lambda self: self.worlds)
    @rule(
        drafts=st.lists(
            st.tuples(NAMES, CLIENTS, st.integers(0, 12), KEYS, BODIES, st.booleans()), min_size=1, max_size=6
        )
    )
    def append(self, drafts) -> None:
        sent, expected = [], []
        for name, client, seq, key, body, next_one in drafts:
            modelled = self.worlds.get(name)
            epoch = modelled.epoch if modelled else (self.gone or ["never"])[-1]
            mark = (
                max((edit.seq or 0 for edit in modelled.edits if edit.client == client), default=0) if modelled else 0
            )
            draft = Draft(
                epoch=epoch,
                digest=body,
                strokes=body,
                stale=b"stale of " + body,
                client=client,
                seq=None if client is None else mark + 1 if next_one else seq,
                key=key,
            )
            sent.append(draft)
            expected.append(modelled.expected(draft) if modelled else WorldGone)
        outcomes = self.store.log.append(sent)
        assert [one if isinstance(one, Outcome) else type(one) for one in outcomes] == expected

    @precondition(lambda self: self.worlds)
    @rule(name=NAMES, share=st.floats(0, 1), part=BODIES)
    def compact(self, name: str, share: float, part: bytes) -> None:
        modelled = self.worlds.get(name)
        if modelled:
            modelled.floor += int(share * (len(modelled.edits) - modelled.floor))
            modelled.parts = {b"part": part}
            self.store.log.compact(modelled.epoch, modelled.floor, modelled.parts.items())

    @invariant()
    def agree(self) -> None:
        kept = self.store.log
        for modelled in self.worlds.values():
            epoch = modelled.epoch
            assert (kept.revision(epoch), kept.floor(epoch)) == (len(modelled.edits), modelled.floor)
            assert kept.foundation(epoch) == (modelled.floor, modelled.parts)
            assert [edit.strokes for edit in kept.read(epoch, modelled.floor)] == [
                draft.strokes for draft in modelled.edits[modelled.floor :]
            ]
            for client in ("ann", "bob", "eve"):
                seqs = [edit.seq for edit in modelled.edits if edit.client == client]
                assert kept.mark(epoch, client) == (seqs[-1] if seqs else None)
        for epoch in self.gone:
            with pytest.raises(WorldGone):
                kept.revision(epoch)


TestLog = LogMachine.TestCase
TestLog.settings = settings(max_examples=count(3000), stateful_step_count=30, deadline=None)


def test_the_model_is_no_mirror():
    """It finds a log that forgets: one look at a machine whose store was emptied behind its back."""
    machine = LogMachine()
    machine.open()
    try:
        machine.create("a")
        machine.append([("a", "ann", 1, None, b"1", True)])
        with machine.store._database.write() as connection:
            connection.execute("DELETE FROM edits")
        with pytest.raises(AssertionError):
            machine.agree()
    finally:
        machine.teardown()
