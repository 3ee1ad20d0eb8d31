"""What is read of a log for those who resume: once for all, in portions, and not faster than others can bear."""

import asyncio
import json
from typing import Any

import pytest

from chunkserver.errors import StoreError
from chunkserver.server import replays
from chunkserver.server.replays import PORTIONS_MAX, TURN_EDITS, Replays
from chunkserver.server.share import BURST_SECONDS, REST, Shares
from chunkserver.store import EditLog
from chunkserver.store.log import Edit
from chunkserver.stream import StreamEdit, limits
from tests.unit.server.edited import PLANE
from tests.unit.stream.worlds import stale_at

EDITS = 1000
SECONDS = 0.002
"""That it takes to make an edit ready, by the clock of the shares."""


class Log(EditLog):
    """Edits that are there from the beginning. reads: behind which revisions, and how many."""

    def __init__(self) -> None:
        self.reads: list[tuple[int, int]] = []
        self.strokes = b"[{}]"

    def read(self, _epoch: str, after: int, limit: int = 1) -> list[Edit]:
        self.reads.append((after, limit))
        if after > EDITS:
            raise StoreError("the disk is gone")
        last = min(after + limit, EDITS)
        return [Edit(revision, self.strokes, stale_at(0), "a", revision) for revision in range(after + 1, last + 1)]


class Case:
    """A log, and what reads it, beside a clock that goes by what is made ready."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.worked = 0.0
        self.log = Log()
        self.shares = Shares(lambda: asyncio.get_running_loop().time() + self.worked)
        world = type("World", (), {"epoch": "an-epoch", "chunk_cells": 16, "recipe": PLANE})
        self.replays = Replays(world(), self.log, self.shares)

        def made(*members: Any) -> StreamEdit:
            self.worked += SECONDS
            return StreamEdit(*members)

        monkeypatch.setattr(replays, "StreamEdit", made)


def test_many_who_resume_at_the_same_revision_are_read_for_once(monkeypatch: pytest.MonkeyPatch):
    async def scenario() -> None:
        case = Case(monkeypatch)
        first = await asyncio.gather(*(case.replays.after(3) for _ in range(9)))
        assert [edit.revision for edit in first[0]] == list(range(4, limits.REPLAYED_AT_ONCE_MAX + 1))
        assert all(each is first[0] for each in first)
        assert await case.replays.after(3) is first[0]
        assert case.log.reads == [(3, limits.REPLAYED_AT_ONCE_MAX - 3)], "the next portion begins where all of them do"

    asyncio.run(scenario())


def test_what_is_kept_is_bounded(monkeypatch: pytest.MonkeyPatch):
    async def scenario() -> None:
        case = Case(monkeypatch)
        for after in range(PORTIONS_MAX + 1):
            await case.replays.after(EDITS - 1 - after)
        assert len(case.replays._portions) == PORTIONS_MAX
        case.log.strokes = bytes(replays.PORTION_BYTES_MAX)
        await case.replays.after(EDITS - 1)
        assert EDITS - 1 not in case.replays._portions
        assert await case.replays.after(EDITS) == []
        for _ in range(2):
            with pytest.raises(StoreError):
                await case.replays.after(EDITS + 1)
        assert [after for after, _ in case.log.reads[-3:]] == [EDITS, EDITS + 1, EDITS + 1], "what fails is not kept"

    asyncio.run(scenario())


def test_all_who_resume_together_leave_time_for_others(monkeypatch: pytest.MonkeyPatch):
    """Each at another revision, so that nothing is read for two of them."""

    async def scenario() -> None:
        case = Case(monkeypatch)
        began = case.shares.clock()
        await asyncio.gather(*(case.replays.after(256 * 3 - 32 + number) for number in range(4)))
        made = case.worked
        assert made == pytest.approx(SECONDS * sum(32 - number for number in range(4)))
        beyond = made - BURST_SECONDS - 4 * SECONDS * TURN_EDITS
        assert case.shares.clock() - began >= 0.9 * REST * beyond
        assert case.shares.pauses > 2

    asyncio.run(scenario())


def test_edits_are_what_the_log_says(monkeypatch: pytest.MonkeyPatch):
    async def scenario() -> None:
        (edit,) = await Case(monkeypatch).replays.after(EDITS - 1)
        assert (edit.revision, edit.client, edit.seq) == (EDITS, "a", EDITS)
        assert json.loads(edit.item) == {"revision": str(EDITS), "strokes": [{}]}

    asyncio.run(scenario())
