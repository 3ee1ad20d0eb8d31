"""The last revision of each chunk, at the ends of the world too."""

from itertools import product

from chunkserver.edits.reach import Range
from chunkserver.edits.reached import Reached, groups_met
from chunkserver.grid import ChunkKey

FAR = 1 << 36


def test_ranges_are_noted_on_their_level_alone():
    reached = Reached()
    first, second = Range(0, (-2, -1, 0), (1, 1, 2)), Range(3, (0, 0, 0), (0, 0, 0))
    reached.note(1, [first, second])
    reached.note(7, [Range(0, (1, 1, 1), (1, 1, 5))])
    for key in (ChunkKey(lod, *place) for lod in (0, 1, 3) for place in product(range(-3, 7), repeat=3)):
        later = key.lod == 0 and key[1:3] == (1, 1) and 1 <= key.z <= 5
        earlier = any(
            key.lod == lod and all(a <= at <= b for a, at, b in zip(low, key[1:], high, strict=True))
            for lod, low, high in (first, second)
        )
        assert reached.last(key) == (7 if later else earlier)
    assert set(reached) == reached.changed
    assert set(reached) == {
        (key.lod, *(at + 2 >> 2 for at in key[1:]))
        for key in (ChunkKey(lod, *place) for lod in (0, 3) for place in product(range(-9, 9), repeat=3))
        if reached.last(key)
    }
    assert reached.groups == len(set(reached))
    assert [groups_met([each]) for each in (first, second)] == [
        len(
            {
                (at + 2 >> 2, row + 2 >> 2, deep + 2 >> 2)
                for at, row, deep in product(*map(range, low, (n + 1 for n in high)))
            }
        )
        for _, low, high in (first, second)
    ]


def test_no_two_chunks_are_taken_for_one():
    places = [-FAR, -FAR + 1, -1, 0, 1, FAR - 2, FAR - 1]
    reached, keys = Reached(), [ChunkKey(0, *place) for place in product(places, repeat=3)]
    for revision, key in enumerate(keys, 1):
        reached.note(revision, [Range(0, key[1:], key[1:])])
    assert [reached.last(key) for key in keys] == list(range(1, len(keys) + 1))
    assert set(reached) == {(0, *(at + 2 >> 2 for at in key[1:])) for key in keys}
