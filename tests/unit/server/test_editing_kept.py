"""What is kept of edits, for the next start: snapshots, and the foundation of a long log."""

import asyncio
import threading
from itertools import product

import pytest

from chunkserver.edits import Bricks
from chunkserver.errors import BadParameter, StoreFull
from chunkserver.grid import ChunkKey
from chunkserver.server import edited_world
from chunkserver.store import EditLog
from chunkserver.store.snapshots import Snapshots
from tests.unit.server.edited import KEY, ball, editing, run


def state_of(edits, world):
    history = edits._worlds[world.epoch].history
    deltas = {key: (brick.deltas.tobytes(), brick.low, brick.high) for key, brick in history.bricks}
    keys = [ChunkKey(lod, *place) for lod in range(3) for place in product((-1, 0), repeat=3)]
    return deltas, [history.last_edit(key) for key in keys], history.revision


@pytest.fixture
def folded(monkeypatch):
    """How many edits were folded, call by call."""
    calls, apply = [], Bricks.apply

    def counted(bricks, edits, *given):
        calls.append(len(edits))
        return apply(bricks, edits, *given)

    monkeypatch.setattr(Bricks, "apply", counted)
    return calls


async def edit_for_a_while(edits, world, count=6):
    for number in range(count):
        edit = ball("add", y=-2.0 * number, strength=2.0) if number % 2 else ball(y=-2.0 * number)
        await edits.take(world, edit, None)
    await edits.bricks(world.epoch, KEY, count)


async def restarted(folder, world):
    """What is known of the world after a start, and after another one that works everything out again."""
    found = []
    for _ in range(2):
        async with editing(folder) as (edits, again):
            assert again.epoch == world.epoch
            await edits.open(again)
            found.append(state_of(edits, again))
        for path in folder.glob("bricks.sqlite*"):
            path.unlink()
    return found


def test_a_start_takes_up_what_was_kept_and_works_nothing_out_again(tmp_path, folded):
    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world)
            before = state_of(edits, world)
        folded.clear()
        async with editing(tmp_path) as (edits, world):
            await edits.open(world)
            assert state_of(edits, world) == before
            assert not folded
            await edits.take(world, ball(), None)
            await edits.bricks(world.epoch, KEY, 7)
            after = state_of(edits, world)
        assert await restarted(tmp_path, world) == [after, after]
        assert folded == [1, 7]

    run(scenario)


def test_what_was_not_kept_is_worked_out_from_there(tmp_path, folded, monkeypatch):
    monkeypatch.setattr(edited_world, "KEPT_SECONDS", 0.01)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world, 3)
            await asyncio.wait_for(edits._worlds[world.epoch]._keeping, 10)
            monkeypatch.setattr(Snapshots, "put", lambda *_: False)
            for _ in range(2):
                await edits.take(world, ball(), None)
                await edits.bricks(world.epoch, KEY, edits.revision(world))
            before = state_of(edits, world)
        monkeypatch.undo()
        folded.clear()
        async with editing(tmp_path) as (edits, world):
            await edits.open(world)
            assert state_of(edits, world) == before
        assert await restarted(tmp_path, world) == [before, before]

    run(scenario)


def test_after_a_failure_all_is_kept(tmp_path, monkeypatch):
    put, since = Snapshots.put, []

    def fails_first(snapshots, *given):
        since.append(given[-1])
        return len(since) != 2 and put(snapshots, *given)

    monkeypatch.setattr(Snapshots, "put", fails_first)
    monkeypatch.setattr(edited_world, "KEPT_SECONDS", 0.01)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            for _ in range(4):
                await edits.take(world, ball("add", strength=1.0), None)
                await edits.bricks(world.epoch, KEY, edits.revision(world))
                await asyncio.wait_for(edits._worlds[world.epoch]._keeping, 10)
            before = state_of(edits, world)
        assert since == [None, 1, None, 2, 3]
        assert await restarted(tmp_path, world) == [before, before]

    run(scenario)


def test_what_is_folded_while_the_snapshot_is_written_is_kept_too(tmp_path, monkeypatch):
    put, begun, go_on = Snapshots.put, threading.Event(), threading.Event()

    def slow(snapshots, *given):
        begun.set()
        assert threading.current_thread().name.startswith("keep"), "others share asyncio's threads"
        assert go_on.wait(30)
        return put(snapshots, *given)

    monkeypatch.setattr(Snapshots, "put", slow)
    monkeypatch.setattr(edited_world, "KEPT_SECONDS", 0.01)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world, 1)
            assert await asyncio.to_thread(begun.wait, 30)
            await edits.take(world, ball(y=-8.0), None)
            await edits.bricks(world.epoch, KEY, 2)
            go_on.set()
        snapshots = Snapshots(tmp_path)
        kept = snapshots.load(world.epoch, world.generator)
        assert kept is not None
        assert kept.revision == 2
        snapshots.close()

    run(scenario)


def test_a_fault_while_keeping_is_told_and_ends_nothing(tmp_path, monkeypatch, caplog):
    def fails(*_):
        raise MemoryError

    monkeypatch.setattr(Snapshots, "put", fails)

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world, 1)

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"] * edited_world.KEEPS_FAILED_MAX


def test_a_world_without_room_is_not_worked_out_from_its_log(tmp_path, folded):
    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world)
        folded.clear()
        async with editing(tmp_path) as (edits, world):
            arena = edits._place.arena
            arena.weight_max = -arena.deltas.nbytes
            with pytest.raises(StoreFull, match="of memory"):
                await edits.open(world)
        assert not folded

    run(scenario)


@pytest.mark.parametrize("spoiled", ["part", "generator", "later"])
def test_a_snapshot_that_is_not_of_this_world_is_not_used(tmp_path, folded, spoiled, caplog):
    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world)
            before = state_of(edits, world)
        folded.clear()
        snapshots = Snapshots(tmp_path)
        if spoiled == "part":
            assert snapshots.put(world.epoch, world.generator, 6, {b"B" + bytes(25): b"none"}.items(), (), 6)
        elif spoiled == "generator":
            assert snapshots.put(world.epoch, "another", 6, {}.items())
        else:
            assert snapshots.put(world.epoch, world.generator, 7, {}.items(), (), 6)
        snapshots.close()
        async with editing(tmp_path) as (edits, world):
            await edits.open(world)
            assert state_of(edits, world) == before
        assert sum(folded) == 6

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["WARNING"] * (spoiled == "part")


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_long_log_gets_a_foundation(tmp_path, monkeypatch, on_disk, folded):
    """Between once and twice as many edits as are kept can be read; and a start without a snapshot has them all."""
    monkeypatch.setattr(edited_world, "KEPT_SECONDS", 0.01)
    folder = tmp_path if on_disk else None

    async def scenario():
        async with editing(folder, log_edits=4) as (edits, world):
            for revision in range(1, 15):
                await edits.take(world, ball("add", y=-float(revision), strength=1.0), None)
                await edits.bricks(world.epoch, KEY, revision)
                keeping = edits._worlds[world.epoch]._keeping
                if keeping is not None:
                    await asyncio.wait_for(keeping, 10)
            log = edits._store.log
            assert (log.floor(world.epoch), log.foundation(world.epoch).revision) == (8, 12)
            while edits._sweeping is not None and not edits._sweeping.done():
                await asyncio.sleep(0.001)
            assert [revision for revision, *_ in await edits.read(world, 8, 100)] == list(range(9, 15))
            with pytest.raises(BadParameter, match="not kept one by one"):
                await edits.read(world, 7, 100)
            before = state_of(edits, world)
        if on_disk:
            folded.clear()
            assert await restarted(tmp_path, world) == [before, before]
            async with editing(tmp_path, log_edits=4) as (edits, world):
                await edits.open(world)
                assert state_of(edits, world) == before
            assert folded == [2, 2], "of the log, without a snapshot"

    run(scenario)


def test_a_foundation_that_cannot_be_laid_is_tried_again_later(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(edited_world, "KEPT_SECONDS", 0.01)
    tried = []

    def full(_log, _epoch, revision, _parts):
        tried.append(revision)
        assert threading.current_thread().name.startswith("lay"), "others share asyncio's threads"
        raise StoreFull("the disk is full")

    monkeypatch.setattr(EditLog, "lay", full)

    async def scenario():
        async with editing(tmp_path, log_edits=20) as (edits, world):
            for revision in range(1, 24):
                await edits.take(world, ball("add", strength=1.0), None)
                await edits.bricks(world.epoch, KEY, revision)
                await asyncio.wait_for(edits._worlds[world.epoch]._keeping, 10)

    run(scenario)
    assert tried == [20, 22]
    assert [record.levelname for record in caplog.records] == ["WARNING"] * 2


def test_the_snapshot_of_a_world_that_is_gone_goes(tmp_path):
    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edit_for_a_while(edits, world)
            edits.forget(world.epoch)
        snapshots = Snapshots(tmp_path)
        assert snapshots.load(world.epoch, world.generator) is None
        snapshots.close()

    run(scenario)


def test_edits_of_another_generator_s_terrain_reach_what_they_change_now(tmp_path):
    """A carve in what was air then, and is rock now: it told nothing then."""

    async def scenario():
        async with editing(tmp_path) as (edits, world):
            await edits.take(world, ball(y=40.0), None)
            await edits.take(world, ball(y=-4.0), None)
            await edits.bricks(world.epoch, KEY, 2)
            log = edits._store.log
            told, *_ = log.read(world.epoch, 0, 1)
            assert (told.stale, log.migrated(world.epoch)) == (b"[]", 0)
            edits._store.catalogue.repin({world.id: "another"})
            assert log.migrated(world.epoch) == 2
            await edits.take(world, ball(y=-4.0), None)
        async with editing(tmp_path) as (edits, world):
            await edits.open(world)
            keys = [ChunkKey(0, 0, 2, 0), KEY, ChunkKey(0, 0, 9, 0)]
            assert [edits.last_edit(world.epoch, key) for key in keys] == [1, 3, 0]

    run(scenario)
