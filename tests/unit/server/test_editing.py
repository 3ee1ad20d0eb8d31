"""Edits on the event loop, when something fails or takes long."""

import asyncio
import threading
from contextlib import asynccontextmanager

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit
from chunkserver.errors import BadParameter, DeadlinePassed, StoreError, WorldGone
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.editing import Editing
from chunkserver.store import Store
from chunkserver.world import World

PLANE = WorldRecipe(0, builtin("plane"))
KEY = ChunkKey(0, 0, -1, 0)


def ball(op="carve", y=-4.0, **more):
    return Edit.of([{"op": op, "shape": "sphere", "center": [0, y, 0], "radius": 4.0, **more}])


@asynccontextmanager
async def editing(folder=None, seconds=60.0):
    """The edits of a store with one world; both are yielded."""
    store = Store(folder)
    world = store.catalogue.page("", 1)[0] if len(store.catalogue) else None
    if world is None:
        made = World(id="w", recipe=PLANE, recipe_name="plane", generator=generator(PLANE), lods=3, chunk_cells=16)
        world = store.catalogue.create(made)
    edits = Editing(store, np.zeros(2048 * 4096, np.int32), seconds)
    try:
        yield edits, world
    finally:
        await asyncio.to_thread(store.writer.close)
        await edits.close()
        store.close()


def run(scenario):
    asyncio.run(asyncio.wait_for(scenario(), 60.0))


def test_an_edit_is_in_the_revision_before_it_is_answered_and_in_the_bricks_when_they_are_waited_for():
    async def scenario():
        async with editing() as (edits, world):
            moved = []
            edits.moved = lambda: moved.append(edits.revision(world))
            assert (edits.revision(world), edits.last_edit(world.epoch, KEY)) == (0, 0)
            for revision in (1, 2, 3):
                answer = await edits.take(world, ball(), None)
                assert (answer.revision, answer.duplicate) == (revision, False)
                assert answer.stale
                assert (edits.revision(world), edits.last_edit(world.epoch, KEY)) == (revision, revision)
                last, bricks = await edits.bricks(world.epoch, KEY, revision)
                assert (last, bricks.revision) == (revision, revision)
            assert moved == [1, 2, 3]

    run(scenario)


def test_edits_at_once_get_revisions_without_a_hole():
    async def scenario():
        async with editing() as (edits, world):
            answers = await asyncio.gather(*(edits.take(world, ball("add", strength=1.0), None) for _ in range(50)))
            assert sorted(answer.revision for answer in answers) == list(range(1, 51))
            _, bricks = await edits.bricks(world.epoch, KEY, 50)
            alone = Bricks(3).apply([ball("add", strength=1.0)] * 50, 50, lambda box: np.zeros(box.shape, np.float32))
            assert {key: brick.deltas.tobytes() for key, brick in bricks} == {
                key: brick.deltas.tobytes() for key, brick in alone
            }

    run(scenario)


def test_a_refused_edit_leaves_nothing_behind():
    async def scenario():
        async with editing() as (edits, world):
            await edits.take(world, ball(), "key")
            with pytest.raises(BadParameter, match="another body"):
                await edits.take(world, ball("fill"), "key")
            again = await edits.take(world, ball(), "key")
            assert (again.revision, again.duplicate) == (1, True)
            edits._store.catalogue.delete("w")
            with pytest.raises(WorldGone):
                await edits.take(world, ball(), None)
            assert edits.revision(world) == 1
            await edits.bricks(world.epoch, KEY, 1)
            assert edits._arena.reserved == 0

    run(scenario)


def test_who_leaves_before_the_answer_has_edited_all_the_same():
    async def scenario():
        async with editing() as (edits, world):
            await edits.open(world)
            leaving = asyncio.ensure_future(edits.take(world, ball(), None))
            await asyncio.sleep(0)
            leaving.cancel()
            await asyncio.gather(leaving, return_exceptions=True)
            assert (await edits.take(world, ball(), None)).revision == 2

    run(scenario)


def test_an_edit_that_is_refused_for_what_is_not_folded_is_tried_again():
    async def scenario():
        async with editing() as (edits, world):
            strong = {"op": "add", "shape": "sphere", "center": [0, 0, 0], "radius": 4.0}
            back_and_forth = [strong | {"strength": sign * 1024.0} for sign in (1, -1)] * 200
            for _ in range(4):
                await edits.take(world, Edit.of(back_and_forth), None)
            assert edits.revision(world) == 4

    run(scenario)


def test_a_chunk_waits_for_its_bricks_and_not_for_ever(monkeypatch):
    async def scenario():
        async with editing(seconds=0.3) as (edits, world):
            held, apply = threading.Event(), Bricks.apply

            def slow(*given):
                assert held.wait(30)
                return apply(*given)

            monkeypatch.setattr(Bricks, "apply", slow)
            await edits.take(world, ball(), None)
            with pytest.raises(DeadlinePassed, match="up to 1"):
                await edits.bricks(world.epoch, KEY, 1)
            waiting = asyncio.ensure_future(edits.bricks(world.epoch, KEY, 1))
            await asyncio.sleep(0.01)
            held.set()
            assert (await waiting)[0] == 1

    run(scenario)


def test_a_world_that_cannot_be_folded_takes_no_more_and_answers_no_edited_chunk(monkeypatch, caplog):
    async def scenario():
        async with editing() as (edits, world):
            monkeypatch.setattr(Bricks, "apply", None)
            await edits.take(world, ball(), None)
            for refused in (edits.bricks(world.epoch, KEY, 1), edits.take(world, ball(), None)):
                with pytest.raises(StoreError, match="cannot be worked out"):
                    await refused
            assert edits.last_edit(world.epoch, KEY) == 1, "it is asked for, so that nobody gets an earlier answer"

    run(scenario)
    assert [record.levelname for record in caplog.records if "worked out" in record.message] == ["CRITICAL"]


def test_a_log_of_many_edits_is_worked_out_again(tmp_path, monkeypatch):
    monkeypatch.setattr("chunkserver.server.editing.REPLAYED_AT_ONCE_MAX", 7)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            for _ in range(20):
                await edits.take(world, ball("add", strength=0.25), None)
            _, bricks = await edits.bricks(world.epoch, KEY, 20)
            before = {key: brick.deltas.tobytes() for key, brick in bricks}
        async with editing(tmp_path) as (edits, world):
            assert (edits.revision(world), edits.last_edit(world.epoch, KEY)) == (20, 0)
            await asyncio.gather(*(edits.open(world) for _ in range(3)))
            assert (edits.revision(world), edits.last_edit(world.epoch, KEY)) == (20, 20)
            _, bricks = await edits.bricks(world.epoch, KEY, 20)
            assert {key: brick.deltas.tobytes() for key, brick in bricks} == before
            assert (await edits.take(world, ball(), None)).revision == 21

    run(scenario)


def test_a_world_that_is_gone_has_no_bricks():
    async def scenario():
        async with editing() as (edits, world):
            await edits.take(world, ball(), None)
            edits.forget(world.epoch)
            assert edits.last_edit(world.epoch, KEY) == 0
            with pytest.raises(StoreError, match="gone"):
                await edits.bricks(world.epoch, KEY, 1)

    run(scenario)
