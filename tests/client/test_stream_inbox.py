"""What a game has not taken yet is bounded."""

from chunkserver_client import ChunkKey, Edits, Refresh, Skipped, StartOver
from chunkserver_client.stream import Inbox
from chunkserver_client.stream.chunks import Chunks
from chunkserver_client.stream.inbox import BYTES_MAX, EVENTS_MAX

KEY = ChunkKey(0, 0, 0, 0)


def edits(revision: int) -> Edits:
    return Edits(revision - 1, revision, (), ())


def taken(inbox: Inbox, chunks: Chunks | None = None) -> list[object]:
    found: list[object] = []
    while (event := inbox.take(chunks or Chunks())) is not None:
        found.append(event)
    return found


def test_events_come_in_their_order_and_before_what_is_to_be_fetched():
    inbox, chunks = Inbox(), Chunks()
    chunks.add(KEY)
    for revision in range(1, EVENTS_MAX + 1):
        inbox.put(edits(revision), 10, revision)
    wanted = [*(edits(revision) for revision in range(1, EVENTS_MAX + 1)), Refresh(frozenset({KEY}), 0)]
    assert taken(inbox, chunks) == wanted
    assert taken(inbox, chunks) == []


def test_too_many_events_are_one():
    inbox = Inbox()
    for revision in range(1, EVENTS_MAX + 2):
        inbox.put(edits(revision), 10, revision)
    inbox.put(edits(EVENTS_MAX + 2), 10, EVENTS_MAX + 2)
    assert taken(inbox) == [Skipped(EVENTS_MAX + 1), edits(EVENTS_MAX + 2)]


def test_too_many_bytes_are_one_event():
    inbox = Inbox()
    for revision in range(1, 4):
        inbox.put(edits(revision), BYTES_MAX // 2, revision)
    assert taken(inbox) == [Skipped(3)]
    for revision in range(4, 100):  # what is taken does not count any more, though one is always left
        inbox.put(edits(revision), BYTES_MAX // 3, revision)
        if revision > 4:
            assert inbox.take(Chunks()) == edits(revision - 1)


def test_another_world_is_not_skipped():
    inbox = Inbox()
    over = StartOver("two", 7, ())
    inbox.put(over, 10, 7)
    for revision in range(8, EVENTS_MAX + 10):
        inbox.put(edits(revision), 10, revision)
    assert taken(inbox)[:2] == [over, Skipped(EVENTS_MAX + 7)]


def test_another_world_forgets_what_was_to_be_fetched():
    inbox, chunks = Inbox(), Chunks()
    for x in range(2):
        chunks.add(ChunkKey(0, x, 0, 0))
    assert isinstance(inbox.take(chunks), Refresh)
    chunks.clear()
    over = StartOver("two", 7, ())
    inbox.put(over, 10, 7)
    assert taken(inbox, chunks) == [over]
