"""Which chunks to fetch, and which to show together."""

from chunkserver_client.mesh import ChunkKey
from chunkserver_client.stream import ChunkRange, Refresh, Region
from chunkserver_client.stream.chunks import Chunks

A, B, C = (ChunkKey(0, x, 0, 0) for x in range(3))
COARSE = ChunkKey(1, 0, 0, 0)


def span(first: int, last: int, lod: int = 0) -> list[ChunkRange]:
    return [ChunkRange(lod, (first, 0, 0), (last, 0, 0))]


def shown(*keys: ChunkKey, revision: int = 0) -> Chunks:
    """Return chunks that have all been fetched as of a revision."""
    chunks = Chunks()
    for key in keys:
        chunks.add(key)
    for refresh in chunks.take():
        chunks.done(refresh, revision)
    assert chunks.are_current
    return chunks


def test_a_chunk_that_is_added_is_fetched_by_itself():
    chunks = Chunks()
    chunks.add(A)
    chunks.add(B)
    chunks.add(A)
    assert chunks.take() == [Refresh(frozenset({A}), 0), Refresh(frozenset({B}), 0)]
    assert not chunks.take()


def test_chunks_of_one_change_are_fetched_together():
    chunks = shown(A, B, C, COARSE)
    chunks.changed([*span(0, 1), *span(0, 0, lod=1)], 5)
    assert chunks.take() == [Refresh(frozenset({A, B, COARSE}), 5)]


def test_changes_that_share_a_chunk_are_one():
    chunks = shown(A, B, C)
    chunks.changed(span(0, 1), 5)
    chunks.changed(span(1, 2), 6)
    assert chunks.take() == [Refresh(frozenset({A, B, C}), 6)]
    chunks = shown(A, B, C)
    chunks.changed(span(0, 1), 6)
    chunks.changed(span(1, 2), 5)
    assert chunks.take() == [Refresh(frozenset({A, B, C}), 6)]


def test_what_is_new_enough_is_not_fetched():
    chunks = shown(A, revision=5)
    chunks.changed(span(0, 0), 5)
    assert chunks.are_current
    chunks.changed(span(0, 0), 6)
    assert not chunks.are_current


def test_what_changes_while_it_is_fetched_is_fetched_again():
    chunks = shown(A, B)
    chunks.changed(span(0, 0), 5)
    [first] = chunks.take()
    chunks.changed(span(0, 1), 6)
    assert not chunks.take()
    chunks.done(first, 5)
    assert chunks.take() == [Refresh(frozenset({A, B}), 6)]


def test_it_is_not_if_it_came_late_enough():
    chunks = shown(A, B)
    chunks.changed(span(0, 0), 5)
    [first] = chunks.take()
    chunks.changed(span(0, 1), 6)
    chunks.done(first, 7)
    assert chunks.take() == [Refresh(frozenset({B}), 6)]


def test_a_first_fetch_is_not_missed_either():
    chunks = Chunks()
    chunks.add(A)
    [first] = chunks.take()
    chunks.changed(span(0, 0), 5)
    chunks.done(first, 4)
    assert chunks.take() == [Refresh(frozenset({A}), 5)]


def test_what_did_not_come_is_fetched_again():
    chunks = shown(A, B)
    chunks.changed(span(0, 1), 5)
    [refresh] = chunks.take()
    chunks.failed(refresh)
    assert chunks.take() == [refresh]


def test_what_is_removed_is_not_fetched():
    chunks = shown(A, B)
    chunks.changed(span(0, 1), 5)
    chunks.remove(A)
    [refresh] = chunks.take()
    assert refresh == Refresh(frozenset({B}), 5)
    chunks.remove(B)
    chunks.add(B)
    chunks.changed(span(1, 1), 6)
    assert not chunks.take()
    chunks.done(refresh, 5)
    assert chunks.take() == [Refresh(frozenset({B}), 6)]


def test_what_was_asked_for_before_all_was_forgotten_is_nothing():
    chunks = Chunks()
    chunks.add(A)
    [old] = chunks.take()
    chunks.clear()
    chunks.add(A)
    [new] = chunks.take()
    assert old == new
    chunks.done(old, 50)
    chunks.failed(old)
    assert not chunks.are_current
    chunks.done(new, 1)
    chunks.changed(span(0, 0), 2)
    assert chunks.take() == [Refresh(frozenset({A}), 2)]


def test_a_region_holds_the_chunks_that_meet_it():
    region = Region((33, 0, 0), (60, 5, 5), lod=1)
    found = [key for key in (A, B, C, COARSE, ChunkKey(2, 0, 0, 0)) if region.holds(key, 32)]
    assert found == [B, COARSE]
