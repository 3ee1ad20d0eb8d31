"""Streams on the event loop: between connections and the log of edits."""

import asyncio
import json

import pytest

from chunkserver.errors import StoreError
from chunkserver.server.streams import Streams
from chunkserver.store import EditLog
from chunkserver.stream import Stream, closing
from tests.unit.server.edited import ball, editing, run

HELLO: dict[str, object] = {"type": "hello", "client": "a", "epoch": None, "resume": None, "regions": []}


async def until(condition):
    async with asyncio.timeout(10):
        while not condition():
            await asyncio.sleep(0.001)


def said(connection):
    """Take what waits to be sent."""
    found = []
    while (frame := connection.outbox.front()) is not None:
        found.append(json.loads(frame))
        connection.sent()
    return found


async def connected(streams, world, **more):
    connection = await streams.connect(world, lambda: None, **{"may_edit": True, **more})
    connection.received(json.dumps(HELLO))
    await until(lambda: connection.outbox.front() or connection.closing)
    return connection


def test_a_world_that_nobody_listens_to_has_no_stream():
    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            first, second = [await connected(streams, world) for _ in range(2)]
            assert first.closing == closing.REPLACED
            assert streams.connections == 1
            for connection in (first, second):
                streams.left(connection)
            assert streams.closed == {closing.REPLACED.code: 1, closing.LEFT.code: 1}
            await until(lambda: not streams._streams)
            await until(lambda: streams._ticking is not None and streams._ticking.done())
            await edits.take(world, ball())
            third = await connected(streams, world)
            assert said(third)[0]["revision"] == "1"
            assert streams.opened == 3
            await streams.close()
            assert third.closing == closing.GOING_AWAY

    run(scenario)


def test_who_may_not_edit_is_told_so_and_it_is_counted():
    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            reader = await connected(streams, world, may_edit=False)
            said(reader)
            reader.received(json.dumps({"type": "edit", "seq": 1, "strokes": json.loads(ball().source)}))
            await until(reader.outbox.front)
            (nack,) = said(reader)
            assert (nack["type"], nack["problem"]["status"]) == ("nack", 403)
            assert [kind.__name__ for kind in edits.counts.refused] == ["ScopeNeeded"]
            assert edits.revision(world) == 0
            await streams.close()

    run(scenario)


@pytest.mark.parametrize("method", ["mark", "read"])
def test_a_log_that_cannot_be_read_ends_the_connection(monkeypatch, method, caplog):
    def fails(*_):
        raise StoreError("the disk is gone")

    async def scenario():
        async with editing() as (edits, world):
            await edits.take(world, ball())
            streams = Streams(edits, edits._store)
            monkeypatch.setattr(EditLog, method, fails)
            connection = await streams.connect(world, lambda: None, may_edit=True)
            connection.received(json.dumps({**HELLO, "epoch": world.epoch, "resume": "0"}))
            await until(lambda: connection.closing)
            assert connection.closing == closing.FAILED
            await streams.close()

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_stream_that_misses_an_edit_ends_and_who_resumes_gets_it(monkeypatch, caplog):
    def fails(*_):
        raise RuntimeError("nobody hears")

    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            first = await connected(streams, world)
            with monkeypatch.context() as patch:
                patch.setattr(Stream, "written", fails)
                assert (await edits.take(world, ball())).revision == 1
            assert first.closing == closing.FAILED
            second = await connected(streams, world)
            assert said(second)[0]["revision"] == "1"
            await streams.close()

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_an_edit_that_fails_for_no_known_reason_ends_the_connection(monkeypatch, caplog):
    async def fails(*_, **__):
        raise RuntimeError("nobody knows why")

    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            first = await connected(streams, world)
            monkeypatch.setattr(edits, "take", fails)
            first.received(json.dumps({"type": "edit", "seq": 1, "strokes": json.loads(ball().source)}))
            await until(lambda: first.closing)
            assert first.closing == closing.FAILED
            await streams.close()

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_stream_that_cannot_tick_ends_alone(monkeypatch, caplog):
    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            first = await connected(streams, world)
            ((_, broken),) = streams._streams.values()
            ticks, real = [], Stream.tick

            def tick(stream):
                if stream is broken:
                    raise RuntimeError("no time")
                ticks.append(stream)
                real(stream)

            monkeypatch.setattr(Stream, "tick", tick)
            await until(lambda: first.closing)
            assert first.closing == closing.FAILED
            await connected(streams, world)
            await until(lambda: len(ticks) > 1)
            await streams.close()

    run(scenario)
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_world_that_goes_closes_its_stream():
    async def scenario():
        async with editing() as (edits, world):
            streams = Streams(edits, edits._store)
            connection = await connected(streams, world)
            edits.forget(world.epoch)
            assert connection.closing == closing.GONE
            await streams.close()

    run(scenario)
