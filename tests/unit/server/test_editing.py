"""Edits on the event loop, when something fails or takes long."""

import asyncio
import gc
import json
import math
import threading
import time

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit, History
from chunkserver.errors import BadParameter, DeadlinePassed, StoreError, StoreFull, WorldGone
from tests.unit.server.edited import KEY, ball, editing, run


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


def test_what_becomes_of_edits_is_counted():
    async def scenario():
        async with editing() as (edits, world):
            counts = edits.counts
            assert edits.standing() == (0, 0, 0, 0, 2048, 0)
            answer = await edits.take(world, ball(), "key")
            assert edits.standing()[:2] == (1, 1), "it is durable, and nobody has had time to fold it"
            await edits.take(world, ball(), "key")
            await edits.bricks(world.epoch, KEY, 1)
            assert edits.standing()[:2] == (1, 0)
            now = edits.standing()
            assert now.bricks == now.slots == len(edits._worlds[world.epoch].history.bricks) > 0
            assert now.weight > 0
            assert (counts.written, counts.strokes, counts.duplicates, counts.folded) == (1, 1, 1, 1)
            ranges = [zip(told["min"], told["max"], strict=True) for told in json.loads(answer.stale)]
            assert counts.stale == sum(math.prod(high - low + 1 for low, high in each) for each in ranges)
            (logged,) = await edits.read(world, 0, 10)
            assert counts.log_bytes == len(logged[1]) + len(logged[2])
            assert [sum(seconds.counts) for seconds in (counts.write_seconds, counts.fold_seconds)] == [1, 1]
            assert min(counts.write_seconds.total, counts.fold_seconds.total) > 0
            with pytest.raises(BadParameter), counts.refusals():
                await edits.take(world, ball("fill"), "key")
            assert counts.refused == {BadParameter: 1}

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
            assert edits._place.arena.reserved == 0

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


def back_and_forth():
    """Twice as much as there is headroom for, if it is not known what becomes of it; and nothing in the end."""
    strong = {"op": "add", "shape": "sphere", "center": [0, 0, 0], "radius": 4.0}
    return Edit.of([strong | {"strength": sign * 1024.0} for sign in (1, -1)] * 200)


def test_edits_that_are_still_being_written_refuse_none_after_them():
    async def scenario():
        async with editing() as (edits, world):
            await edits.open(world)
            append, go_on = edits._store.writer._append, threading.Event()
            edits._store.writer._append = lambda drafts: go_on.wait(30) and append(drafts)
            tasks = [asyncio.ensure_future(edits.take(world, back_and_forth(), None)) for _ in range(4)]
            while len(edits._worlds[world.epoch].history._taken) < 2:
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.01)
            go_on.set()
            answers = await asyncio.gather(*tasks)
            assert [answer.revision for answer in answers] == [1, 2, 3, 4]

    run(scenario)


def test_an_edit_that_is_sent_again_takes_no_headroom():
    async def scenario():
        async with editing() as (edits, world):
            for count in range(6):
                assert (await edits.take(world, back_and_forth(), "key")).duplicate is (count > 0)
                await edits.bricks(world.epoch, KEY, 1)

    run(scenario)


def test_who_waits_for_a_world_that_goes_is_told_and_its_room_is_given_back():
    async def scenario():
        async with editing() as (edits, world):
            go_on = threading.Event()
            edits._place.thread.submit(go_on.wait, 30)
            for _ in range(2):
                await edits.take(world, back_and_forth(), None)
            waiting = edits.take(world, back_and_forth(), None), edits.bricks(world.epoch, KEY, 2)
            tasks = [asyncio.ensure_future(each) for each in waiting]
            await asyncio.sleep(0.01)
            edits._store.catalogue.delete("w")
            edits.forget(world.epoch)
            for task in tasks:
                with pytest.raises(WorldGone):
                    await asyncio.wait_for(task, 10)
            go_on.set()
            del tasks, task, waiting
            await asyncio.gather(*edits._leaving)
            arena, end = edits._place.arena, time.monotonic() + 10
            while (arena.reserved, arena.promised) != (0, 0):
                assert time.monotonic() < end
                await asyncio.sleep(0.01)
                gc.collect()

    run(scenario)


def test_a_world_that_goes_while_it_is_opened_is_let_go_of(tmp_path):
    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edits.take(world, ball(), None)
        async with editing(tmp_path) as (edits, world):
            read, done, go_on = edits._store.log.read, threading.Event(), threading.Event()

            def slow(*given):
                found = read(*given)
                if not found:
                    done.set()
                    assert go_on.wait(30)
                return found

            edits._store.log.read = slow
            opening = asyncio.ensure_future(edits.open(world))
            assert await asyncio.to_thread(done.wait, 30)
            edits._store.catalogue.delete("w")
            edits.forget(world.epoch)
            go_on.set()
            await opening
            await asyncio.sleep(0)
            assert not edits._worlds

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


def test_edits_without_room_together_are_folded_a_few_at_a_time(monkeypatch):
    apply, counts = Bricks.apply, []

    def narrow(bricks, edits, *given):
        counts.append(len(edits))
        if len(edits) > 3:
            raise StoreFull("no room")
        return apply(bricks, edits, *given)

    monkeypatch.setattr(Bricks, "apply", narrow)

    async def scenario():
        async with editing() as (edits, world):
            await asyncio.gather(*(edits.take(world, ball("add", strength=1.0), None) for _ in range(20)))
            assert (await edits.bricks(world.epoch, KEY, 20))[1].revision == 20
        assert max(counts) > 3

    run(scenario)


def test_the_fault_of_a_world_does_not_grow(monkeypatch):
    async def scenario():
        async with editing() as (edits, world):
            monkeypatch.setattr(Bricks, "apply", None)
            await edits.take(world, ball(), None)
            depths = set()
            for _ in range(5):
                with pytest.raises(StoreError) as caught:
                    await edits.bricks(world.epoch, KEY, 1)
                depths.add(len(caught.traceback))
            assert len(depths) <= 2, "the first has waited for it"

    run(scenario)


def test_a_log_of_many_edits_is_worked_out_again(tmp_path, monkeypatch):
    monkeypatch.setattr("chunkserver.server.edited_world.REPLAYED_AT_ONCE_MAX", 7)

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


def test_others_get_their_turn_while_a_log_is_read_again(tmp_path, monkeypatch):
    turns, logged, note = [0], [], History.logged

    def noted(*given, **named):
        logged.append(turns[0])
        note(*given, **named)

    monkeypatch.setattr(History, "logged", noted)

    async def count():
        while True:
            turns[0] += 1
            await asyncio.sleep(0)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            for _ in range(5):
                await edits.take(world, ball(), None)
        for path in tmp_path.glob("bricks.sqlite*"):
            path.unlink()
        async with editing(tmp_path) as (edits, world):
            counting = asyncio.ensure_future(count())
            await edits.open(world)
            counting.cancel()
        assert len(set(logged)) == 5

    run(scenario)


def test_large_edits_are_measured_beside_the_loop_and_stay_in_order(monkeypatch):
    begun, go_on, measured = threading.Event(), threading.Event(), History.measuring

    def slow(history, edit):
        measure = measured(history, edit)

        def wait():
            begun.set()
            assert go_on.wait(30)
            return measure()

        return wait if len(edit.strokes) > 1 else measure

    monkeypatch.setattr(History, "measuring", slow)

    async def scenario():
        async with editing() as (edits, world):
            strokes = [{"op": "carve", "shape": "sphere", "center": [x, -4, 0], "radius": 4.0} for x in range(40)]
            large = asyncio.ensure_future(edits.take(world, Edit.of(strokes), None))
            while not begun.is_set():
                await asyncio.sleep(0.001)
            left = asyncio.ensure_future(edits.take(world, ball(), None))
            small = asyncio.ensure_future(edits.take(world, ball(), None))
            await asyncio.sleep(0.01)
            left.cancel()
            assert not small.done()
            go_on.set()
            assert [(await large).revision, (await small).revision] == [1, 2]

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
