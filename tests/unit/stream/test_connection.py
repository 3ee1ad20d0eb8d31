"""One connection: what it answers, what it asks of the journal, and when it ends."""

import json

import hypothesis
import hypothesis.strategies as st
import pytest

from chunkserver.stream import Connection, answers, closing, limits
from tests.unit.stream.worlds import EVERYWHERE, World, edit_of, hello, new_edit, stale_at, taken

PROBLEM = {"type": "t", "title": "no", "status": 422, "detail": "no"}


def is_paused(connection: Connection) -> bool:
    return connection.is_paused


def end(connection: Connection) -> closing.Close | None:
    return connection.closing


def code_of(connection: Connection) -> int | None:
    return None if connection.closing is None else connection.closing.code


def test_hello_is_answered_when_the_client_is_known():
    world = World(7)
    connection = world.connect()
    connection.received(hello("me"))
    assert world.journal.introductions == [(connection, "me")]
    assert not taken(connection)
    connection.introduced(41, 3)
    told = {"epoch": "an-epoch", "revision": "7", "floor": "3", "last_seq": 41, "limits": limits.LIMITS}
    assert taken(connection) == [{"type": "welcome", **told}]


def test_an_edit_is_acknowledged_when_it_is_written_and_not_before():
    world = World()
    connection = world.welcomed("me")
    connection.received(new_edit(5))
    assert world.journal.submitted == [(connection, "me", 5, [{"op": "carve"}])]
    world.tick()
    assert not taken(connection)
    world.written(client="me", seq=5)
    ranges = json.loads(stale_at(0))
    assert taken(connection) == [{"type": "ack", "seq": 5, "revision": "1", "duplicate": False, "stale": ranges}]


def test_an_edit_may_be_refused_or_known():
    world = World()
    connection = world.welcomed()
    for seq in (1, 2, 3):
        connection.received(new_edit(seq))
    connection.refused(2, PROBLEM)
    connection.repeated(1, 9, stale_at(4))
    connection.repeated(3, 8, b"")
    assert taken(connection) == [
        {"type": "nack", "seq": 2, "problem": PROBLEM},
        {"type": "ack", "seq": 1, "revision": "9", "duplicate": True, "stale": json.loads(stale_at(4))},
        {"type": "ack", "seq": 3, "revision": "8", "duplicate": True, "stale": None},
    ]


def test_an_edit_is_answered_once():
    world = World()
    connection = world.welcomed("me")
    connection.received(new_edit(1))
    world.written(client="me", seq=1)
    connection.repeated(1, 1, stale_at(0))
    connection.refused(1, PROBLEM)
    assert [message["type"] for message in taken(connection)] == ["ack"]


def test_an_edit_of_an_earlier_connection_is_answered_on_this_one():
    world = World()
    before = world.welcomed("me")
    before.received(new_edit(1))
    connection = world.welcomed("me")
    assert before.closing == closing.REPLACED
    world.written(client="me", seq=1)
    assert [(message["seq"], message["duplicate"]) for message in taken(connection)] == [(1, True)]


def test_too_many_edits_without_an_answer_pause_it():
    world = World()
    connection = world.welcomed("me")
    for seq in range(limits.INFLIGHT_MAX):
        assert not is_paused(connection)
        connection.received(new_edit(seq))
    assert is_paused(connection)
    connection.outbox.put(b"1")
    before = world.wakes
    world.written(client="me", seq=0)
    assert not is_paused(connection)
    assert world.wakes > before


def test_too_much_that_is_unsent_pauses_it():
    world = World()
    connection = world.welcomed()
    connection.outbox.put(bytes(limits.QUEUE_BYTES_MAX))
    assert is_paused(connection)


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([new_edit(1)], 4412),
        (['{"type":"subscribe","regions":[]}'], 4412),
        ([hello(), hello()], 4412),
        ([hello(), new_edit(1)], 4412),
        (["no"], 4400),
        (["x" * (limits.FRAME_BYTES_MAX + 1)], 1009),
    ],
)
def test_what_may_not_come_ends_it(frames: list[str], code: int):
    connection = World().connect()
    for frame in frames:
        connection.received(frame)
    assert code_of(connection) == code


def test_a_seq_that_does_not_rise_ends_it():
    for seqs in ((3, 3), (3, 2)):
        connection = World().welcomed()
        for seq in seqs:
            connection.received(new_edit(seq))
        assert end(connection) == closing.out_of_order(f"seq {seqs[1]} follows 3")


def test_too_many_regions_end_it():
    connection = World().welcomed(regions=[])
    boxes = [{"min": [x, 0, 0], "max": [x, 0, 0]} for x in range(limits.REGIONS_MAX + 1)]
    connection.received(json.dumps({"type": "subscribe", "regions": boxes[1:]}))
    assert end(connection) is None
    connection.received(json.dumps({"type": "subscribe", "regions": boxes[:1]}))
    assert code_of(connection) == 4400


def test_a_reason_fits_a_close_frame():
    reason = closing.malformed("é" * 500).reason
    assert len(reason.encode()) <= closing.REASON_BYTES_MAX


def test_who_says_no_hello_is_dropped():
    world = World()
    connection, other = world.connect(), world.welcomed()
    world.tick(limits.HELLO_SECONDS - 0.01)
    assert end(connection) is None
    world.tick(0.02)
    assert end(connection) == closing.NO_HELLO
    assert other.closing is None


def test_who_takes_nothing_is_dropped():
    world = World()
    connection = world.welcomed()
    world.written()
    world.tick()
    for _ in range(100):
        world.tick(limits.SEND_SECONDS / 99)
    assert end(connection) == closing.TOO_SLOW
    assert not len(world.stream)


def test_who_takes_something_now_and_then_is_not():
    world = World()
    connection = world.welcomed()
    connection.outbox.put(b"1")
    for _ in range(10):
        connection.outbox.put(b"1")
        world.tick(limits.SEND_SECONDS * 0.9)
        taken(connection, 1)
    assert end(connection) is None


def test_who_has_nothing_to_take_is_not():
    world = World()
    connection = world.welcomed()
    world.tick(limits.SEND_SECONDS * 2)
    assert end(connection) is None


def test_what_comes_after_its_end_is_ignored():
    world = World()
    connection = world.welcomed("me")
    connection.received(new_edit(1))
    connection.outbox.put(b"1")
    before = world.wakes
    connection.close(closing.LEFT)
    assert world.wakes > before
    connection.received(new_edit(2))
    connection.repeated(1, 1, b"[]")
    connection.refused(1, PROBLEM)
    connection.replayed([edit_of(1)], 0)
    connection.compacted(0)
    connection.sent()
    connection.close(closing.FAILED)
    world.written()
    world.tick()
    assert end(connection) == closing.LEFT
    assert connection.outbox.front() is None
    assert len(world.journal.submitted) == 1


def test_an_introduction_that_comes_too_late_is_ignored():
    world = World()
    connection = world.connect()
    connection.received(hello())
    connection.close(closing.LEFT)
    connection.introduced(None, 0)
    assert connection.outbox.front() is None


def test_a_stream_that_stops_tells_everybody():
    world = World()
    connections = [world.welcomed("a"), world.connect()]
    world.stream.close()
    assert [connection.closing for connection in connections] == [closing.GOING_AWAY] * 2
    assert not len(world.stream)


def test_a_client_that_was_replaced_leaves_the_new_one_alone():
    world = World()
    world.welcomed("me")
    connection = world.welcomed("me")
    world.written(client="me", seq=1)
    assert [message["type"] for message in taken(connection)] == ["ack"]
    assert len(world.stream) == 1


def test_limits_are_those_that_are_told():
    assert json.loads(answers.welcome("e", 0, 0, None))["limits"]["regions"] == limits.REGIONS_MAX
    assert EVERYWHERE["max"] == [limits.PLACE_MAX] * 3


MESSAGES = (
    *("no", '{"type":"subscribe","regions":[]}', '{"type":"unsubscribe","regions":[]}'),
    *(hello(resume=resume) for resume in (None, 0, 3, 5, 99)),
    *(new_edit(seq) for seq in range(5)),
)


@hypothesis.given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, len(MESSAGES) - 1)), max_size=40))
def test_whatever_happens_it_is_open_or_closed_and_bounded(turns: list[tuple[int, int]]):
    """Frames, answers, edits of others and sent frames in any order: no error, and no more waits than may."""
    world = World(5)
    connection = world.connect()
    for turn, number in [(0, 3), *turns] if len(turns) % 2 else turns:
        match turn:
            case 0 | 1:
                connection.received(MESSAGES[number])
            case 2:
                connection.introduced(None, number % 5)
            case 3:
                world.written(number, client=("a", "b", None)[number % 3], seq=number)
            case 4:
                world.tick(number / 4)
            case 5 if connection.outbox.front() is not None:
                connection.sent()
            case 6:
                connection.refused(number % 5, PROBLEM)
            case 7:
                replays = list(world.journal.replays)
                world.journal.replays.clear()
                for asked, after in replays:
                    if number % 2:
                        asked.replayed([edit_of(revision) for revision in range(after + 1, 6)], 0)
                    else:
                        asked.compacted(5)
    assert (connection.closing is None) is (len(world.stream) == 1)
    assert len(taken(connection)) <= 600
