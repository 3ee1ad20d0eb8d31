"""How far a connection has got: what it is told, in which order, and what instead if it is too slow."""

import json
from typing import Any

import pytest

from chunkserver.stream import Connection, limits, outbox, reader, recent
from chunkserver.stream.limits import BEHIND_SECONDS, PROGRESS_SECONDS, QUEUE_BYTES_MAX
from chunkserver.stream.regions import Box, Region
from tests.unit.stream.worlds import CELLS, World, edit_of, hello, stale_at, taken


def box(first: int, last: int, lod: int = 20) -> dict[str, Any]:
    """Return a region inside the chunks from `first` to `last` of LOD 0, along x."""
    return {"min": [first * CELLS + 1, 0, 0], "max": [(last + 1) * CELLS - 1, 9, 9], "lod": lod}


def kinds(messages: list[dict[str, Any]]) -> list[str]:
    return [message["type"] for message in messages]


def revisions(message: dict[str, Any]) -> list[int]:
    return [int(edit["revision"]) for edit in message["edits"]]


def test_edits_of_a_tick_come_together():
    world = World(3)
    connection = world.welcomed()
    world.written(strokes=b'[{"op":"carve"}]')
    world.written(stale=stale_at(0, 1))
    assert not taken(connection)
    world.tick()
    [message] = taken(connection)
    assert (message["type"], message["after"], message["revision"]) == ("edits", "3", "5")
    assert message["edits"] == [{"revision": "4", "strokes": [{"op": "carve"}]}, {"revision": "5", "strokes": [{}]}]
    assert message["stale"] == json.loads(stale_at(0, 1))


def test_all_who_are_equally_far_get_the_same_bytes():
    world = World()
    connections = [world.welcomed(str(number)) for number in range(3)]
    world.written()
    world.tick()
    frames = [connection.outbox.front() for connection in connections]
    assert frames[0] is frames[1] is frames[2] is not None


def test_only_what_is_in_the_regions_is_told():
    world = World()
    connection = world.welcomed(regions=[box(0, 0), box(5, 6)])
    for x in (0, 1, 2, 4, 5, 7, 8):
        world.written(stale=stale_at(x))
    world.written(stale=b"[]")
    world.tick()
    [message] = taken(connection)
    assert revisions(message) == [1, 5]
    assert message["revision"] == "8"


def test_a_region_has_a_coarsest_level():
    coarse = json.dumps([*json.loads(stale_at(9)), {"lod": 4, "min": [0, 0, 0], "max": [0, 0, 0]}]).encode()
    for lod, is_told in ((0, False), (3, False), (4, True), (20, True)):
        world = World()
        connection = world.welcomed(regions=[box(0, 0, lod)])
        world.written(stale=coarse)
        world.tick()
        assert bool(taken(connection)) is is_told, lod


def test_what_goes_on_where_nothing_is_told_begins_where_it_ended():
    world = World()
    connection = world.welcomed(regions=[box(0, 0)])
    world.written(3, stale=stale_at(9))
    world.tick()
    world.written()
    world.tick()
    [message] = taken(connection)
    assert (message["after"], message["revision"], revisions(message)) == ("0", "4", [4])


def test_progress_comes_when_nothing_else_does():
    world = World()
    connection = world.welcomed(regions=[])
    world.written()
    world.tick(PROGRESS_SECONDS * 0.9)
    assert not taken(connection)
    world.tick(PROGRESS_SECONDS * 0.2)
    assert taken(connection) == [{"type": "progress", "revision": "1", "asked": 0}]
    world.tick(PROGRESS_SECONDS * 0.9)
    assert not taken(connection)


def test_own_edits_are_answered_and_not_told():
    world = World()
    connection = world.welcomed("me")
    world.written(client="me", seq=1)
    world.written(client="you", seq=1)
    world.tick()
    ack, edits = taken(connection)
    assert ack["revision"] == "1"
    assert revisions(edits) == [2]


def test_who_resumes_is_told_what_it_has_missed():
    world = World()
    world.written(5)
    connection = world.welcomed(resume=2)
    world.tick()
    [message] = taken(connection)
    assert (message["after"], revisions(message)) == ("2", [3, 4, 5])


def test_who_resumes_with_another_epoch_begins_anew():
    world = World()
    world.written(5)
    connection = world.connect()
    connection.received(hello(resume=2, epoch="old"))
    connection.introduced(None, 0)
    assert kinds(taken(connection)) == ["welcome"]
    world.tick()
    assert not taken(connection)


def test_who_resumes_has_its_own_edits_answered_first():
    world = World()
    world.written()
    world.written(client="me", seq=4)
    world.written()
    connection = world.welcomed("me", resume=0)
    world.tick()
    ack, edits = taken(connection)
    assert (ack["seq"], ack["revision"], ack["duplicate"]) == (4, "2", True)
    assert revisions(edits) == [1, 3]


def test_what_is_not_recent_is_read_from_the_log():
    world = World(10)
    connection = world.welcomed(resume=4)
    world.tick()
    world.tick()
    assert world.journal.replays == [(connection, 4)]
    connection.replayed([edit_of(revision) for revision in (5, 6, 7)], 0)
    assert world.journal.replays[1:] == [(connection, 7)]
    connection.replayed([edit_of(revision) for revision in (8, 9, 10)], 0)
    assert [(message["after"], revisions(message)) for message in taken(connection)] == [
        ("4", [5, 6, 7]),
        ("7", [8, 9, 10]),
    ]


def test_what_is_compacted_meanwhile_is_resynced():
    world = World(10)
    connection = world.welcomed(resume=4)
    world.tick()
    connection.compacted(9)
    assert taken(connection) == [{"type": "resync", "floor": "9", "revision": "10", "epoch": "an-epoch"}]
    world.written()
    world.tick()
    assert [message["after"] for message in taken(connection)] == ["10"]


@pytest.mark.parametrize(("resume", "floor"), [(4, 5), (11, 0)])
def test_who_resumes_where_it_cannot_is_resynced(resume: int, floor: int):
    world = World(10)
    connection = world.welcomed(resume=resume, floor=floor)
    assert kinds(taken(connection)) == ["resync"]


def test_who_has_missed_too_much_is_resynced():
    world = World(limits.REPLAYED_MAX + 1)
    assert not taken(world.welcomed("a", resume=1))
    assert kinds(taken(world.welcomed("b", resume=0))) == ["resync"]


def test_a_connection_reads_the_log_so_far_and_no_further(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reader, "REPLAYED_MAX", 5)
    world = World(10)
    connection = world.welcomed(resume=0)
    world.tick()
    connection.replayed([edit_of(revision) for revision in (1, 2, 3)], 0)
    connection.replayed([edit_of(revision) for revision in (4, 5, 6)], 0)
    assert kinds(taken(connection)) == ["edits", "resync"]
    assert len(world.journal.replays) == 2


def test_who_has_no_room_is_told_later():
    world = World()
    connection = world.welcomed()
    full(connection)
    world.written(3)
    world.tick()
    taken(connection, 1)
    [message] = taken(connection)
    assert revisions(message) == [1, 2, 3]


def test_who_is_behind_for_too_long_is_told_what_is_stale():
    world = World()
    connection = world.welcomed("me", regions=[box(0, 3)])
    full(connection)
    world.written(stale=stale_at(0))
    world.written(stale=stale_at(1, 9))
    world.written(stale=stale_at(7))
    world.written(stale=stale_at(2), client="me", seq=1)
    world.tick()
    world.tick(BEHIND_SECONDS * 1.1)
    world.written(stale=stale_at(3))
    world.tick(BEHIND_SECONDS * 1.1)
    world.written(stale=stale_at(0))
    ack, stale = taken(connection)[1:]
    assert ack["revision"] == "4"
    assert stale == {"type": "stale", "chunks": json.loads(stale_at(0, 1, 9, 3)), "revision": "6"}
    world.written(stale=stale_at(0))
    world.tick()
    [message] = taken(connection)
    assert (message["after"], revisions(message)) == ("6", [7])


def test_who_is_overtaken_is_told_what_is_stale(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(recent, "RECENT_EDITS_MAX", 8)
    world = World()
    connection = world.welcomed()
    full(connection)
    for x in range(9):
        world.written(stale=stale_at(x))
    assert world.stream.recent.start == 3
    world.tick()
    assert taken(connection)[1:] == [{"type": "stale", "chunks": json.loads(stale_at(*range(9))), "revision": "9"}]
    assert not world.journal.replays


def test_other_regions_are_in_force_when_all_before_is_told():
    world = World()
    connection = world.welcomed(regions=[box(0, 0)])
    world.written(stale=stale_at(0))
    world.written(stale=stale_at(5))
    connection.received(json.dumps({"type": "subscribe", "regions": [box(5, 5)]}))
    world.written(stale=stale_at(5))
    connection.received(json.dumps({"type": "unsubscribe", "regions": [box(0, 0), box(1, 1)]}))
    world.written(stale=stale_at(0))
    world.tick()
    messages = taken(connection)
    assert kinds(messages) == ["edits", "progress", "edits", "progress"]
    assert [revisions(message) for message in messages if message["type"] == "edits"] == [[1], [3]]
    assert [(message["revision"], message["asked"]) for message in messages[1::2]] == [("2", 1), ("3", 2)]


def test_many_edits_come_in_more_than_one_message():
    world = World()
    connection = world.welcomed()
    world.written(10, strokes=b'["' + b"x" * 20_000 + b'"]')
    world.tick()
    frames = []
    while (frame := connection.outbox.front()) is not None:
        frames.append(frame)
        connection.sent()
    messages = [json.loads(frame) for frame in frames]
    assert max(map(len, frames)) <= limits.FRAME_BYTES_MAX
    assert [revision for message in messages for revision in revisions(message)] == list(range(1, 11))
    assert [message["after"] for message in messages[1:]] == [message["revision"] for message in messages[:-1]]


def test_no_message_is_too_long():
    corner = [(1 << 40) // CELLS - 1] * 3
    stale = json.dumps(
        [{"lod": 20, "min": [-x, *corner[1:]], "max": corner} for x in range(limits.RANGES_MAX)]
    ).encode()
    world = World()
    connection = world.welcomed()
    for length in (10, 40_000, 45_000, limits.FRAME_BYTES_MAX - 40, limits.FRAME_BYTES_MAX):
        world.written(strokes=b'["' + b"x" * length + b'"]', stale=stale)
    world.tick()
    while (frame := connection.outbox.front()) is not None:
        assert len(frame) <= limits.FRAME_BYTES_MAX
        connection.sent()


def test_many_ranges_of_a_level_are_told_as_one():
    found = edit_of(1, stale=stale_at(*range(0, 2 * limits.RANGES_MAX + 2, 2))).ranges
    assert [(each.lod, each.box) for each in found] == [(0, ((0, 0, 0), (2 * limits.RANGES_MAX, 0, 0)))]
    assert len(edit_of(1, stale=stale_at(*range(0, 2 * limits.RANGES_MAX, 2))).ranges) == limits.RANGES_MAX


def full(connection: Connection) -> None:
    """Leave no room in its outbox."""
    connection.outbox.put(json.dumps("x" * QUEUE_BYTES_MAX).encode())


def test_what_lies_between_two_ranges_is_not_in_reach():
    ranges = [*json.loads(stale_at(0, 9)), {"lod": 4, "min": [0, 0, 0], "max": [0, 0, 0]}]
    edit = edit_of(1, stale=json.dumps(ranges).encode())
    between = Box((4 * CELLS + 1, 0, 0), (5 * CELLS - 1, 9, 9))
    assert not edit.is_in(frozenset({Region(between, 0)}))
    assert edit.is_in(frozenset({Region(between, 4)}))


def test_who_reads_the_log_is_not_too_slow():
    world = World(10)
    world.written(2)
    connection = world.welcomed(resume=4)
    world.tick()
    world.tick(BEHIND_SECONDS * 1.1)
    connection.replayed([edit_of(revision) for revision in range(5, 11)], 0)
    told = [revisions(message) for message in taken(connection) if message["type"] == "edits"]
    assert told == [[5, 6, 7, 8, 9, 10], [11, 12]]


def test_nothing_is_put_where_there_is_no_room():
    world = World()
    connection = world.welcomed(regions=[])
    full(connection)
    for _ in range(3):
        world.tick(PROGRESS_SECONDS * 1.1)
    connection.received(json.dumps({"type": "subscribe", "regions": [box(0, 0)]}))
    connection.received(json.dumps({"type": "subscribe", "regions": [box(5, 5)]}))
    world.written(stale=stale_at(0))
    taken(connection, 1)
    assert [(message["revision"], message["asked"]) for message in taken(connection)] == [("1", 2)]
    world.written(stale=stale_at(0))
    world.written(stale=stale_at(5))
    world.tick()
    assert [revisions(message) for message in taken(connection)] == [[2, 3]]


def test_own_edits_are_answered_once_however_little_room_there_is(monkeypatch: pytest.MonkeyPatch):
    world = World()
    for seq in range(3):
        world.written(client="me", seq=seq)
    world.written()
    connection = world.welcomed("me", resume=0)
    monkeypatch.setattr(outbox, "QUEUE_BYTES_MAX", 1)
    world.tick()
    messages = [message for _ in range(5) for message in taken(connection, 1)]
    assert [message["revision"] for message in messages] == ["1", "2", "3", "4"]


def test_only_those_who_are_behind_are_overtaken(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(recent, "RECENT_EDITS_MAX", 8)
    world = World()
    connection = world.welcomed()
    world.written(8)
    world.tick()
    world.written()
    world.tick()
    assert [revisions(message) for message in taken(connection)] == [[*range(1, 9)], [9]]


def test_what_is_recent_is_bounded_in_bytes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(recent, "RECENT_BYTES_MAX", 8 * edit_of(1).weight)
    world = World()
    starts = []
    for _ in range(16):
        world.written()
        starts.append(world.stream.recent.start)
    assert starts == [0] * 8 + [3] * 3 + [6] * 3 + [9] * 2
