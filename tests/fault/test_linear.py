"""The checker of histories finds each kind of fault, and none where there is none."""

import re
from copy import deepcopy

import pytest

from chunkserver.grid import ChunkKey
from tests.fault.linear import Known, Logged, Range, Record, Seen, Sent, faults, last

A, B, FAR = (ChunkKey(0, x, 0, 0) for x in (0, 1, 9))
AT_A = (Range(0, (-1, 0, 0), (0, 0, 0)),)
AT_BOTH = (Range(1, (0, 0, 0), (0, 0, 0)), Range(0, (0, -1, 0), (1, 0, 0)))
AT_B = (Range(0, (1, 0, 0), (1, 0, 0)),)


def seen(key, begin, revision, world: int | None, end=0.0, status=200, **more) -> Seen:
    """An answer a second long, whose tag and bytes are those of the chunk at this revision."""
    name = f"{key.x} at {revision}"
    bytes_ = None if status == 304 else f"bytes of {name}"
    return Seen(key, begin, end or begin + 1, status, name, revision, world, bytes_, **more)


RECORD = Record(
    sent=[
        Sent(0, 1.0, 3.0, 1, AT_A),
        Sent(1, 2.0, 6.0, 2, AT_BOTH),  # begun before the first was answered
        Sent(2, 7.0),  # never answered, but it is in the log
        Sent(3, 20.0, 21.0, 4, AT_A),
        Sent(4, 30.0),  # never answered, and not written
    ],
    log=[Logged(1, 0, AT_A), Logged(2, 1, AT_BOTH), Logged(3, 2, AT_B), Logged(4, 3, AT_A)],
    seen=[
        seen(A, 0.0, 0, 0, end=0.5),
        seen(A, 1.5, 1, 1),  # while it was written
        seen(A, 3.5, 1, 1),
        seen(B, 6.5, 2, 2),
        seen(B, 8.0, 2, 2, status=304, had="1 at 2"),
        seen(B, 9.0, 3, 3, end=12.0, min_revision=3),
        seen(FAR, 9.5, 0, 2, end=12.5),
        seen(A, 13.0, 2, None, pinned=3, kept=True),
        seen(B, 13.0, 3, 3, pinned=2),
        seen(A, 22.0, 4, 4, pinned=3),
        seen(A, 24.0, 4, None, pinned=4, kept=True),
    ],
)


def test_nothing_is_wrong_with_what_could_have_been():
    assert list(faults(RECORD)) == []
    assert list(faults(Record())) == []


def seen_as(place, **values):
    return lambda record: record.seen.__setitem__(place, record.seen[place]._replace(**values))


def sent_as(place, **values):
    return lambda record: record.sent.__setitem__(place, record.sent[place]._replace(**values))


def logged_as(place, **values):
    return lambda record: record.log.__setitem__(place, record.log[place]._replace(**values))


FAULTS = [
    # the log
    (logged_as(2, revision=4), "the log has a hole"),
    (logged_as(2, name=1), "the log has an edit twice"),
    (logged_as(2, name=77), "edit 77, which nobody has sent"),
    (sent_as(0, begin=6.5, end=6.8), "revision 2 had its answer before an earlier one was sent"),
    (lambda record: record.log.pop(), "edit 3 was acknowledged as 4, and the log has not that"),
    (sent_as(1, revision=1), "edit 1 was acknowledged as 1, and the log has not that"),
    (sent_as(1, stale=AT_A), "what edit 1 made stale is not what it was told"),
    # tags and bytes
    (seen_as(2, tag="0 at 7"), r"1\) has two tags"),
    (seen_as(3, tag="0 at 1"), "has the tag of"),
    (seen_as(4, had="1 at 1"), "not modified, but what the client had is another tag"),
    (seen_as(2, digest="other"), "has other bytes than it had"),
    # the world's revision
    (seen_as(3, world=1), "the world's revision 1 .* is older than the chunk's, 2"),
    (seen_as(5, min_revision=4), "the world's revision 3 .* is older than was asked for, 4"),
    (seen_as(2, revision=0, tag="0 at 0", digest="bytes of 0 at 0", world=0), "the world's revision 0 .* acknowledged"),
    (seen_as(8, world=2), "the world's revision 2 .* is older than was seen before, 3"),
    (seen_as(1, world=2, end=1.9), "the world's revision 2 .* had not begun"),
    (seen_as(10, world=5), "the world's revision 5 .* had not begun"),
    # the chunk's
    (seen_as(2, revision=0, tag="0 at 0", digest="bytes of 0 at 0"), "revision 0 of .* acknowledged before, 1"),
    (seen_as(8, revision=2, tag="1 at 2", digest="bytes of 1 at 2", pinned=None), "revision 2 .* was seen before, 3"),
    (seen_as(5, revision=2, tag="1 at 2", digest="bytes of 1 at 2"), "revision 2 .* is older than was asked for, 3"),
    (seen_as(6, revision=2, tag="9 at 2", digest="x"), "revision 2 .* is of an edit that has not reached it"),
    (seen_as(0, revision=1, tag="0 at 1", digest="bytes of 0 at 1", world=1), "(?m)^revision 1 of .* had not begun"),
    (seen_as(7, kept=False), "asked for as of 3, may not be kept"),
    (seen_as(9, kept=True), "asked for as of 3, may be kept"),
    (seen_as(2, kept=True), "asked for as of None, may be kept"),
    (seen_as(10, revision=2, tag="0 at 2", digest="bytes of 0 at 2"), "revision 2 .* is not that as of 4"),
]  # fmt: skip


@pytest.mark.parametrize(("plant", "said"), FAULTS)
def test_each_fault_is_found(plant, said):
    record = deepcopy(RECORD)
    plant(record)
    assert record != RECORD
    found = "\n".join(faults(record))
    assert re.search(said, found), found


def test_the_largest_that_was_known():
    known = Known([(5.0, 2), (1.0, 3), (9.0, 7)])
    assert [known.before(time) for time in (0.0, 1.0, 1.1, 5.5, 9.0, 9.1)] == [0, 0, 3, 3, 3, 7]
    assert last([0, 2, 5], 1) == 0
    assert (last([0, 2, 5], 2), last([0, 2, 5], 9)) == (2, 5)
