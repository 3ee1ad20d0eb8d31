"""The log beside a model of it that is a few dictionaries: whatever is done in whatever order, they agree."""

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from chunkserver.errors import BadParameter, StoreFull, WorldGone
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Draft, Outcome, Store, appending, foundation, sweeping
from chunkserver.world import World
from tests.fault.disk import Disk
from tests.scale import count

KEYS_MAX = 3
CLIENTS_MAX = 2
NAMES = st.sampled_from("ab")
CLIENTS = st.sampled_from([None, "ann", "bob", "eve"])
KEYS = st.sampled_from([None, None, "k", "l", "m", "n", "o"])
PARTS = st.dictionaries(st.binary(max_size=2), st.binary(max_size=2), max_size=5)
MEANWHILE = st.sampled_from(["append", "append", "sweep", "delete"])
SWEEPS_MAX = 1000
TABLES = ("edits", "clients", "keys", "foundations", "parts", "unswept")
BODIES = st.sampled_from([b"", b"1", b"2", b"3"])


@dataclass
class Modelled:
    """What is known of one world. The revision of edits[n] is start + n + 1; those up to `swept` are not kept."""

    epoch: str
    edits: list[Draft] = field(default_factory=list)
    start: int = 0
    swept: int = 0
    floor: int = 0
    founded: int = 0
    parts: dict[bytes, bytes] = field(default_factory=dict)

    @property
    def revision(self) -> int:
        return self.start + len(self.edits)

    def expected(self, draft: Draft) -> Outcome | type[Exception]:
        """Return what a log has to answer, and take the draft in if it is new."""
        for revision, edit in self.keyed():
            if draft.key == edit.key:
                return self._again(draft, edit, revision)
        if draft.client is not None:
            mine = [(revision, edit) for revision, edit in self.numbered() if edit.client == draft.client]
            gone = [(revision, edit) for revision, edit in mine if revision <= self.swept]
            for revision, edit in mine[len(gone) :]:
                if edit.seq == draft.seq:
                    return self._again(draft, edit, revision)
            if gone and (draft.seq or 0) <= (gone[-1][1].seq or 0):
                return Outcome(gone[-1][0], b"", duplicate=True)
            if mine and (draft.seq or 0) < (mine[-1][1].seq or 0):
                return BadParameter
        known = {edit.client for edit in self.edits} - {None}
        if draft.client not in (None, *known) and len(known) >= CLIENTS_MAX:
            return StoreFull
        self.edits.append(draft)
        return Outcome(self.revision, draft.stale)

    def lay(self, revision: int, parts: dict[bytes, bytes]) -> bool:
        """Return whether the log takes this foundation, and take it in."""
        if not self.revision:
            self.start = self.floor = revision
        elif self.founded <= revision <= self.revision:
            self.floor = self.founded
        else:
            return False
        self.founded, self.parts = revision, parts
        return True

    def numbered(self) -> list[tuple[int, Draft]]:
        return [(self.start + number, edit) for number, edit in enumerate(self.edits, 1)]

    def keyed(self) -> list[tuple[int, Draft]]:
        return [(revision, edit) for revision, edit in self.numbered() if edit.key is not None][-KEYS_MAX:]

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
        self.limits = [
            mock.patch.object(appending, "KEYS_MAX", KEYS_MAX),
            mock.patch.object(appending, "CLIENTS_MAX", CLIENTS_MAX),
            mock.patch.object(foundation, "STEP_ROWS_MAX", 2),
            mock.patch.object(sweeping, "STEP_ROWS_MAX", 2),
        ]
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
    @rule(name=NAMES, share=st.floats(0, 1), parts=PARTS, meanwhile=st.lists(MEANWHILE, max_size=3))
    def lay(self, name: str, share: float, parts: dict[bytes, bytes], meanwhile: list[str]) -> None:
        modelled = self.worlds.get(name)
        if not modelled:
            return
        low = max(1, modelled.founded)
        revision = low + int(share * (modelled.revision - low)) if modelled.revision else 1 + int(share * 9)
        self.lay_at(name, revision, parts, meanwhile)

    def lay_at(self, name: str, revision: int, parts: dict[bytes, bytes], meanwhile: list[str]) -> None:
        modelled = self.worlds[name]

        def coming() -> Iterator[tuple[bytes, bytes]]:
            for part, what in zip_longest(parts.items(), meanwhile):
                if part:
                    yield part
                if what:
                    self.do_meanwhile(what, name)

        laid: type[Exception] | None = None
        try:
            self.store.log.lay(modelled.epoch, revision, coming())
        except (BadParameter, WorldGone) as error:
            laid = type(error)
        if self.worlds.get(name) is not modelled:
            assert laid is WorldGone
        else:
            assert laid is (None if modelled.lay(revision, dict(parts)) else BadParameter)

    def do_meanwhile(self, what: str, name: str) -> None:
        if what == "append":
            self.append([(name, "ann", 0, None, b"1", True), (name, None, None, "k", b"2", False)])
        elif what == "sweep":
            self.sweep()
        else:
            self.delete(name)

    @rule()
    def sweep(self) -> None:
        self.store.log.sweep()
        for modelled in self.worlds.values():
            modelled.swept = self.swept(modelled)
            assert modelled.swept <= modelled.floor

    def swept(self, modelled: Modelled) -> int:
        """Up to where the edits are gone: the first rows, and no others."""
        query = "SELECT edits.revision FROM logs JOIN edits USING (world) WHERE epoch = ? ORDER BY 1"
        with self.store._database.read() as connection:
            kept = [revision for (revision,) in connection.execute(query, (modelled.epoch,))]
        assert kept == list(range(modelled.revision + 1 - len(kept), modelled.revision + 1))
        return modelled.revision - len(kept)

    @precondition(lambda self: self.worlds)
    @rule(name=NAMES)
    def sweep_all(self, name: str) -> None:
        """Lay the floor as high as it goes, and sweep until nothing is left to do."""
        if name in self.worlds and self.worlds[name].revision:
            for _ in range(2):
                self.lay_at(name, self.worlds[name].revision, {}, [])
        for _ in range(SWEEPS_MAX):
            if not self.store.log.sweep():
                break
        self.sweep()
        with self.store._database.read() as connection:
            left = {table: connection.execute(f"SELECT count(*) FROM {table}").get for table in TABLES}
        worlds = list(self.worlds.values())
        assert left == {
            "edits": len([None for one in worlds for _ in range(one.revision - one.floor)]),
            "clients": len({(one.epoch, edit.client) for one in worlds for edit in one.edits if edit.client}),
            "keys": len([None for one in worlds for _ in one.keyed()]),
            "foundations": len([None for one in worlds if one.founded]),
            "parts": len([None for one in worlds for _ in one.parts]),
            "unswept": 0,
        }

    @invariant()
    def agree(self) -> None:
        kept = self.store.log
        for modelled in self.worlds.values():
            epoch = modelled.epoch
            assert (kept.revision(epoch), kept.floor(epoch)) == (modelled.revision, modelled.floor)
            revision, parts = kept.foundation(epoch)
            assert (revision, dict(parts)) == (modelled.founded, modelled.parts)
            assert [(edit.revision, edit.strokes) for edit in kept.read(epoch, modelled.floor)] == [
                (revision, draft.strokes) for revision, draft in modelled.numbered() if revision > modelled.floor
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
