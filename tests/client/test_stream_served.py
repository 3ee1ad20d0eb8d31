"""Streams of edits by the real server: both kinds of client, cut connections, and a server that is killed."""

import asyncio
import dataclasses
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from itertools import count
from typing import Any

import numpy as np
import pytest

from chunkserver_client import (
    Ack,
    AsyncClient,
    ChunkKey,
    Client,
    EditLost,
    Edits,
    EditStream,
    Gone,
    Nack,
    NotFound,
    Problem,
    Progress,
    Refresh,
    Region,
    Retry,
    Skipped,
    StreamEnded,
    Unreachable,
    WorldDescriptor,
)
from chunkserver_client.stream import inbox, session
from tests.client.wires import Wire, wire
from tests.serving import Server, serving, until

SECONDS_MAX = 20.0
QUICK = Retry(seconds_max=SECONDS_MAX, backoff_seconds=0.02, backoff_seconds_max=0.1)
IDS = (f"stream-{number}" for number in count())
KEY = ChunkKey(0, 0, -1, 0)


def ball(x: float = 0.0, **more: Any) -> list[dict[str, Any]]:
    return [{"op": "carve", "shape": "sphere", "center": [x, 0, 0], "radius": 4.0, **more}]


def new_world(client: Client) -> WorldDescriptor:
    return client.create_world(next(IDS), 7, "plane", chunk_cells=16, lods=2)


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client(server.url, retry=QUICK) as client:
        yield client


@pytest.fixture
def line(server: Server) -> Iterator[Wire]:
    with wire(server.url) as line:
        yield line


@pytest.fixture
def far(line: Wire) -> Iterator[Client]:
    """A client behind the proxy."""
    with Client(line.url, retry=QUICK) as client:
        yield client


@pytest.fixture
def world(client: Client) -> Iterator[WorldDescriptor]:
    world = new_world(client)
    yield world
    if any(found.id == world.id for found in client.worlds()):
        client.delete_world(world.id)


def ack(answer: Future[Ack]) -> Ack:
    return answer.result(SECONDS_MAX)


def told(stream: EditStream, revision: int) -> list[Any]:
    """Return all events until everything up to a revision is known."""
    until(lambda: stream.revision >= revision, SECONDS_MAX, f"revision {revision}")
    return stream.poll()


def revisions(events: list[Any]) -> list[int]:
    """Return the revisions of the edits of others, in their order."""
    return [edit.revision for each in events if isinstance(each, Edits) for edit in each.edits]


def test_an_edit_is_acknowledged_and_others_are_told(client, world):
    with client.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        answer = ack(alice.edit(ball()))
        assert (answer.revision, answer.duplicate) == (1, False)
        event = next(bob)
        assert isinstance(event, Edits)
        assert (event.edits[0].revision, event.stale) == (1, answer.stale)
        assert event.edits[0].strokes == [*next(client.edits(world)).strokes]
        assert next(alice) == answer
        assert revisions(told(alice, 1)) == [], "its own edit is answered, and not told"


def test_the_same_on_an_event_loop(server, world):
    async def play() -> None:
        async with (
            asyncio.timeout(SECONDS_MAX),
            AsyncClient(server.url, retry=QUICK) as client,
            client.stream(world, "alice") as alice,
            client.stream(world, "bob") as bob,
        ):
            answers = await asyncio.gather(*(alice.edit(ball(x)) for x in range(5)))
            assert [answer.revision for answer in answers] == [1, 2, 3, 4, 5]
            found: list[Any] = []
            async for event in bob:
                found.append(event)
                if len(revisions(found)) == 5:
                    break
            assert revisions(found) == [1, 2, 3, 4, 5]
            with pytest.raises(Problem):
                await alice.edit(ball(radius=-1.0))
            await bob.close()
            assert [event async for event in bob] == []
        assert len(asyncio.all_tasks()) == 1

    asyncio.run(play())


def test_a_loop_that_waits_for_its_own_edit_comes_to_its_end(server, world):
    async def play() -> None:
        async with (
            asyncio.timeout(SECONDS_MAX),
            AsyncClient(server.url, retry=QUICK) as client,
            client.stream(world, "alice") as alice,
        ):
            alice.edit(ball())
            found = []
            async for event in alice:
                found.append(type(event))
                if alice.revision == 1:
                    break
            assert found == [Ack, Progress]

    asyncio.run(play())


def test_what_an_edit_changes_is_fetched_and_shown(client, far, world):
    with far.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        alice.show(KEY, ChunkKey(0, 50, 0, 0))
        for refresh in alice.poll():
            assert refresh.revision == 0
            alice.shown(refresh)
        assert alice.are_chunks_current
        before = far.chunk(world, KEY, revision=0)
        ack(bob.edit(ball()))
        events = told(alice, 1)
        [refresh] = [each for each in events if isinstance(each, Refresh)]
        assert isinstance(events[0], Edits), "it comes behind the edit"
        assert refresh == Refresh(frozenset({KEY}), 1)
        assert alice.poll() == []
        assert (before.revision, far.chunk(world, KEY, revision=0).revision) == (0, 1), "the cache was told"
        alice.failed(refresh)
        [again] = alice.poll()
        assert again == refresh
        [mesh] = far.chunks(world, refresh.keys, min_revision=refresh.revision)
        assert mesh.revision == 1
        alice.shown(again)
        assert alice.are_chunks_current
        alice.hide(KEY)
        ack(alice.edit(ball()))
        assert [type(each) for each in told(alice, 2)] == [Ack, Progress]


def test_a_refused_edit_says_why(client, world):
    with client.stream(world, "alice") as alice:
        with pytest.raises(Problem, match="radius") as found:
            ack(alice.edit(ball(radius=-1.0)))
        assert found.value.status == 422
        event = next(alice)
        assert isinstance(event, Nack)
        assert event.problem is found.value
        assert ack(alice.edit(ball(center=np.array([1.5, 0.0, 0.0]), radius=np.float32(3)))).revision == 1
        with pytest.raises(ValueError, match="65536"):
            alice.edit(ball() * 1500)


def test_regions(client, world):
    home, away = Region((0, 0, 0), (15, 15, 15), lod=0), Region((160, 0, 0), (175, 15, 15), lod=0)
    with client.stream(world, "alice", regions=[home]) as alice, client.stream(world, "bob") as bob:
        ack(bob.edit(ball(168)))
        assert revisions(told(alice, 1)) == []
        alice.subscribe(away)
        until(lambda: away in alice.regions, SECONDS_MAX, "the region is in force")
        ack(bob.edit(ball(168)))
        assert revisions(told(alice, 2)) == [2]
        alice.unsubscribe(away)
        assert alice.regions == (home,)
    with pytest.raises(ValueError, match="low is nowhere above"):
        client.stream(world, "alice", regions=[Region((1, 0, 0), (0, 0, 0))])
    with pytest.raises(ValueError, match="128 visible"):
        client.stream(world, "al ice")


def test_a_connection_that_is_cut_is_made_again_and_nothing_is_missed(client, far, line, world):
    with far.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        ack(bob.edit(ball()))
        found = told(alice, 1)
        line.target = None
        line.cut()
        until(lambda: not alice.is_live, SECONDS_MAX, "the connection is lost")
        answers = [bob.edit(ball(x)) for x in range(3)]
        own = [alice.edit(ball(x)) for x in range(3)]
        assert {ack(answer).revision for answer in answers} == {2, 3, 4}
        assert alice.unanswered == 3
        line.target = client_url(client)
        assert [ack(answer).revision for answer in own] == [5, 6, 7]
        assert revisions(found + told(alice, 7)) == [1, 2, 3, 4]
        assert revisions(told(bob, 7)) == [5, 6, 7]


def client_url(client: Client) -> str:
    return client._address.url


def test_edits_are_written_once_however_often_the_connection_is_cut(client, far, line, world):
    with far.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        answers = []
        for number in range(60):
            answers.append(alice.edit(ball(number)))
            if number % 10 == 9:
                ack(answers[-5])
                line.cut()
        found = [ack(answer).revision for answer in answers]
        assert found == list(range(1, 61))
        assert revisions(told(bob, 60)) == found
    assert [edit.strokes[0]["center"][0] for edit in client.edits(world)] == list(range(60))
    assert line.opened > 3


def test_a_connection_that_falls_silent_is_given_up(client, far, line, world, monkeypatch):
    monkeypatch.setattr(session, "SILENCE_SECONDS", 2.0)
    with far.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        opened = line.opened
        line.hold()
        own = alice.edit(ball())
        ack(bob.edit(ball(5)))
        ack(own)
        assert line.opened > opened
        assert revisions(told(alice, 2)) == [2 if own.result().revision == 1 else 1]


def test_who_takes_no_events_is_told_that_they_were_skipped(client, world, monkeypatch):
    monkeypatch.setattr(inbox, "EVENTS_MAX", 3)
    with client.stream(world, "alice") as alice, client.stream(world, "bob") as bob:
        alice.show(KEY)
        for refresh in alice.poll():
            alice.shown(refresh)
        for x in range(20):
            revision = ack(bob.edit(ball(x))).revision
            until(lambda: alice.revision == revision, SECONDS_MAX, "each is told by itself")  # noqa: B023
        found = alice.poll()
        assert isinstance(found[0], Skipped)
        assert revisions(found) == list(range(found[0].revision + 1, 21))
        assert found[-1] == Refresh(frozenset({KEY}), found[-1].revision)
        assert len(found) <= 5


def test_the_server_ends_a_stream_for_good(client, world):
    with client.stream(world, "alice") as first, client.stream(world, "alice") as second:
        with pytest.raises(StreamEnded, match="4409: another connection of the same name"):
            next(first)
        with pytest.raises(StreamEnded, match="4409"):
            first.edit(ball())
        with pytest.raises(StreamEnded, match="4409"):
            first.poll()
        ack(second.edit(ball()))
        client.delete_world(world.id)
        with pytest.raises(StreamEnded, match="4404: the world is gone"):
            list(second)
    with pytest.raises(StreamEnded, match="4404") as found, client.stream(world, "alice"):
        pass
    assert isinstance(found.value.__cause__, NotFound)


def test_a_descriptor_of_another_world_opens_nothing(client, world):
    before = threading.active_count()
    with pytest.raises(Gone, match="epoch"), client.stream(dataclasses.replace(world, epoch="0" * 32), "alice"):
        pass
    assert threading.active_count() == before


def test_edits_that_nobody_answers_are_lost(far, line, world):
    with far.stream(world, "alice") as alice:
        line.target = None
        line.cut()
        answer = alice.edit(ball())
    with pytest.raises(EditLost, match="this side has closed it"):
        ack(answer)
    with pytest.raises(StreamEnded, match="this side has closed it"):
        alice.edit(ball())
    assert list(alice) == []
    alice.close()
    with pytest.raises(ValueError, match="not open"):
        far.stream(world, "bob").edit(ball())


def test_a_stream_ends_its_thread_also_when_the_server_is_away(far, line, world):
    before = threading.active_count()
    waiting: list[Any] = []
    with far.stream(world, "alice") as alice:
        consumer = threading.Thread(target=lambda: waiting.extend(alice))
        consumer.start()
        line.target = None
        line.cut()
        until(lambda: not alice.is_live, SECONDS_MAX, "the connection is lost")
    consumer.join(SECONDS_MAX)
    assert not consumer.is_alive()
    assert threading.active_count() == before


def test_a_server_that_stays_away_is_unreachable(line, world):
    line.target = None
    patience = dataclasses.replace(QUICK, seconds_max=0.3)
    with Client(line.url, retry=patience) as client, pytest.raises(Unreachable, match="no welcome"):
        client.stream(world, "alice").__enter__()


@contextmanager
def killed(log: Any, *options: str) -> Iterator[Server]:
    """Run a server that is killed at the end."""
    try:
        with serving(log, *options) as server:
            yield server
            server.stop(signal.SIGKILL)
    except AssertionError as error:
        if "exit code -9" not in str(error):
            raise


def test_a_killed_server_loses_nothing_and_doubles_nothing(tmp_path):
    options = ("--workers", "1", "--data", str(tmp_path / "data"))
    with wire(None) as line, Client(line.url, retry=QUICK) as client, ExitStack() as streams:
        with killed(tmp_path / "first", *options) as first:
            line.target = first.url
            world = new_world(client)
            alice, bob = (streams.enter_context(client.stream(world, name)) for name in ("alice", "bob"))
            answers = [each.edit(ball(x)) for x in range(20) for each in (alice, bob)]
            ack(answers[20])
        answers += [alice.edit(ball(x)) for x in range(20, 30)]
        line.target = None
        with serving(tmp_path / "second", *options) as second:
            line.target = second.url
            found = sorted(ack(answer).revision for answer in answers)
            assert found == list(range(1, 51))
            assert len(revisions(told(alice, 50))) == 20
            assert len(revisions(told(bob, 50))) == 30
            assert len(list(client.edits(world))) == 50
            streams.close()
