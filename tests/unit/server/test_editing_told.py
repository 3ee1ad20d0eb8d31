"""Edits on the event loop: who is told what, when something is in the way."""

import asyncio

import pytest

from chunkserver.edits import Bricks
from chunkserver.errors import StoreFull
from chunkserver.server import edited_world
from tests.unit.server.edited import KEY, ball, editing, run


def test_edits_that_wait_for_room_for_long_are_told_once(monkeypatch, caplog):
    apply, missing = Bricks.apply, 6

    def full(bricks, edits, *given):
        nonlocal missing
        missing -= 1
        if missing > 0:
            raise StoreFull("no room")
        return apply(bricks, edits, *given)

    monkeypatch.setattr(Bricks, "apply", full)
    monkeypatch.setattr(edited_world, "ROOM_SECONDS", 0.02)
    monkeypatch.setattr(edited_world, "ROOM_TOLD_SECONDS", 0.05)

    async def scenario():
        async with editing() as (edits, world):
            await edits.take(world, ball())
            await edits.bricks(world.epoch, KEY, 1)

    run(scenario)
    (record,) = caplog.records
    assert (record.levelname, record.args[:2]) == ("WARNING", (1, "w"))


@pytest.mark.parametrize("hook", ["told", "moved"])
def test_who_sent_an_edit_is_answered_also_if_the_others_cannot_be_told(hook, caplog):
    def fails(*_):
        raise RuntimeError("nobody hears")

    async def scenario():
        async with editing() as (edits, world):
            setattr(edits, hook, fails)
            answer = await asyncio.wait_for(edits.take(world, ball()), 10.0)
            assert (answer.revision, edits.revision(world)) == (1, 1)

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"]
