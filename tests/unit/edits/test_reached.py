"""The last revision of each chunk, at the ends of the world too."""

from itertools import product

from chunkserver.edits.reach import Range
from chunkserver.edits.reached import Reached, holds
from chunkserver.grid import ChunkKey

FAR = 1 << 36


def test_ranges_are_noted_on_their_level_alone():
    reached = Reached()
    first, second = Range(0, (-2, -1, 0), (1, 1, 2)), Range(3, (0, 0, 0), (0, 0, 0))
    reached.note(1, [first, second])
    reached.note(7, [Range(0, (1, 1, 1), (1, 1, 5))])
    for key in (ChunkKey(lod, *place) for lod in (0, 1, 3) for place in product(range(-3, 7), repeat=3)):
        later = key.lod == 0 and key[1:3] == (1, 1) and 1 <= key.z <= 5
        assert reached.last(key) == (7 if later else holds([first, second], key))
    assert len(reached) == 4 * 3 * 3 + 1 + 3


def test_no_two_chunks_are_taken_for_one():
    places = [-FAR, -FAR + 1, -1, 0, 1, FAR - 2, FAR - 1]
    reached, keys = Reached(), [ChunkKey(0, *place) for place in product(places, repeat=3)]
    for revision, key in enumerate(keys, 1):
        reached.note(revision, [Range(0, key[1:], key[1:])])
    assert [reached.last(key) for key in keys] == list(range(1, len(keys) + 1))
    assert len(reached) == len(keys)
