from dataclasses import replace

import pytest

from chunkserver.errors import StoreError
from chunkserver.store import Store, migrate
from tests.unit.store.worlds import edited, world


def token(recipe):
    """What a newer server's generator would be called."""
    return f"new-{recipe.seed}"


def two_worlds(folder):
    kept = Store(folder)
    worlds = [kept.catalogue.create(world(name, seed)) for name, seed in (("a", 1), ("b", 2))]
    kept.close()
    return worlds


def found_in(folder):
    kept = Store(folder)
    worlds = kept.catalogue.page("", 9)
    kept.close()
    return worlds


def test_a_world_moves_to_another_generator_and_all_else_stays(folder):
    first, second = two_worlds(folder)
    moved = replace(first, generator="new-1")
    assert migrate(folder, ["a"], token) == [(moved, "0123")]
    assert found_in(folder) == [moved, second]
    assert moved.epoch == first.epoch
    assert migrate(folder, [], token) == [(replace(second, generator="new-2"), "0123")]
    assert migrate(folder, [], token) == []
    assert [one.generator for one in found_in(folder)] == ["new-1", "new-2"]


def test_all_worlds_move_or_none(folder):
    before = two_worlds(folder)
    with pytest.raises(StoreError, match="there is no world 'c'"):
        migrate(folder, ["a", "c"], token)
    edited(folder, """UPDATE worlds SET source = '{"op":"gone"}' WHERE id = 'b'""")
    for _ in range(2):  # the folder is given back
        with pytest.raises(StoreError, match="world 'b' has a recipe"):
            migrate(folder, [], token)
    assert found_in(folder)[0] == before[0]


def test_a_disk_that_fails_moves_nothing(folder):
    before = two_worlds(folder)
    edited(
        folder,
        "CREATE TRIGGER full BEFORE UPDATE ON worlds WHEN old.id = 'b' BEGIN SELECT RAISE(ABORT, 'no more'); END",
    )
    with pytest.raises(StoreError, match="no more"):
        migrate(folder, [], token)
    assert found_in(folder) == before


def test_where_there_are_no_worlds_nothing_is_made(folder):
    with pytest.raises(StoreError, match="holds no worlds"):
        migrate(folder, [], token)
    assert not folder.exists()


def test_nothing_moves_under_a_server(folder):
    kept = Store(folder)
    with pytest.raises(StoreError, match="is in use"):
        migrate(folder, [], token)
    kept.close()
