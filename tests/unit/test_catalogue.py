import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest import mock

import apsw
import pytest

from chunkserver import catalogue
from chunkserver.catalogue import APPLICATION_ID, FILE_NAME, FORMAT, LOCK_NAME, Catalogue, World, migrate
from chunkserver.errors import BadParameter, StoreError, StoreFull
from chunkserver.recipe import WorldRecipe, builtin, canonical
from tests.scale import count

TERRAIN = builtin("terrain")
WORLDS_WRITTEN = count(20_000)


def world(name="a", seed=42, source=TERRAIN, **values):
    return World(id=name, recipe=WorldRecipe(seed, source), recipe_name="terrain", generator="0123", **values)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "new" / "folder"


def edited(folder, *statements):
    """What another program does to the file."""
    connection = apsw.Connection(str(folder / FILE_NAME))
    for statement in statements:
        connection.execute(statement)
    connection.close()


def refused(folder, *words):
    """The catalogue does not open, says why, and gives the folder back."""
    before = (folder / FILE_NAME).read_bytes()
    for _ in range(2):
        with pytest.raises(StoreError) as caught:
            Catalogue(folder)
        assert str(folder / FILE_NAME) in caught.value.message
        for word in words:
            assert word in caught.value.message
    assert (folder / FILE_NAME).read_bytes() == before, "what is not understood is not written to"


def test_what_was_created_is_there_after_a_restart(folder):
    worlds = [
        world("b", -(2**63), builtin("planet"), voxel_size=0.1, lods=21, chunk_cells=64),
        world("a", 2**63 - 1, canonical({"op": "sphere", "radius": 20})),
        world("_-0", 0),
    ]
    first = Catalogue(folder)
    for one in worlds:
        assert first.create(one) is one
    first.close()
    second = Catalogue(folder)
    assert [second.find(one.id) for one in worlds] == worlds
    assert len(second) == 3
    second.close()


def test_without_a_folder_it_lasts_as_long_as_the_catalogue(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = Catalogue()
    first.create(world())
    assert first.find("a")
    first.close()
    assert Catalogue().find("a") is None
    assert not list(tmp_path.iterdir())


def test_an_id_belongs_to_the_first_until_it_is_deleted(folder):
    kept = Catalogue(folder)
    first, second = world(seed=1), world(seed=2)
    assert kept.create(first) is first
    assert kept.create(second) is first
    assert kept.delete("a") is first
    assert kept.delete("a") is kept.find("a") is None
    assert kept.create(second) is second
    kept.close()
    again = Catalogue(folder)
    assert again.find("a") == second
    again.delete("a")
    again.close()
    assert not len(Catalogue(folder))


def test_each_world_has_an_epoch_of_its_own():
    assert world().epoch != world().epoch
    assert len(bytes.fromhex(world().epoch)) == catalogue.EPOCH_BYTES


def test_pages():
    kept = Catalogue()
    for name in ("c", "a-", "a", "b", "_"):
        kept.create(world(name))
    assert [one.id for one in kept.page("", 10)] == ["_", "a", "a-", "b", "c"]
    assert [one.id for one in kept.page("", 2)] == ["_", "a"]
    assert [one.id for one in kept.page("a", 2)] == ["a-", "b"]
    assert [one.id for one in kept.page("aa", 10)] == ["b", "c"], "the last one seen may have been deleted since"
    assert kept.page("c", 10) == []


def test_it_is_durable_before_it_answers(folder):
    """Another connection sees it, and the file is synced: SQLite says how it commits."""
    kept = Catalogue(folder)
    kept.create(world())
    connection = apsw.Connection(str(folder / FILE_NAME), flags=apsw.SQLITE_OPEN_READONLY)
    assert connection.pragma("journal_mode") == "wal"
    assert connection.execute("SELECT id FROM worlds").get == "a"
    assert kept._connection.pragma("synchronous") == 2
    connection.close()
    kept.close()


@pytest.mark.parametrize("answer", ["delete", "memory"])
def test_a_disk_that_cannot_keep_its_promise_is_refused(folder, answer):
    class Careless(apsw.Connection):
        def pragma(self, name, *values, **options):
            return answer if name == "journal_mode" else super().pragma(name, *values, **options)

    with (
        mock.patch.object(apsw, "Connection", Careless),
        pytest.raises(StoreError, match=f"journal_mode is '{answer}'"),
    ):
        Catalogue(folder)


def test_the_folder_has_one_server(folder):
    first = Catalogue(folder)
    with pytest.raises(StoreError, match=rf"{folder} is in use"):
        Catalogue(folder)
    with pytest.raises(StoreError, match="is in use"):
        Catalogue(folder / ".." / folder.name)
    first.close()
    Catalogue(folder).close()


def test_a_child_does_not_hold_the_folder(folder):
    first = Catalogue(folder)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, close_fds=False)
    try:
        first.close()
        Catalogue(folder).close()
    finally:
        child.communicate(b"\n")


def test_the_folder_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be used"):
        Catalogue(tmp_path / "file" / "folder")


def test_a_newer_format_is_refused(folder):
    Catalogue(folder).close()
    edited(folder, f"PRAGMA user_version = {FORMAT + 1}")
    refused(folder, f"format {FORMAT + 1}", "use a newer one")


def test_the_file_of_another_program_is_refused(folder):
    folder.mkdir(parents=True)
    edited(folder, "CREATE TABLE worlds (id TEXT)")
    refused(folder, "another program")
    edited(folder, f"PRAGMA application_id = {APPLICATION_ID + 1}", f"PRAGMA user_version = {FORMAT}")
    refused(folder, "another program")
    (folder / FILE_NAME).write_bytes(b"no database at all" * 1000)
    refused(folder, "not a database")


def test_a_torn_file_is_refused(folder):
    kept = Catalogue(folder)
    for number in range(200):
        kept.create(world(f"w{number}"))
    kept.close()
    whole = (folder / FILE_NAME).read_bytes()
    page = int.from_bytes(whole[16:18], "big")
    for cut in (page, len(whole) // page // 2 * page, len(whole) - page):
        (folder / FILE_NAME).write_bytes(whole[:cut])
        refused(folder, "malformed")
    (folder / FILE_NAME).write_bytes(whole[: 2 * page] + bytes(page) + whole[3 * page :])
    refused(folder)
    (folder / FILE_NAME).write_bytes(whole.replace(b"w150", b"zzzz"))
    refused(folder, "damaged", "order")
    (folder / FILE_NAME).write_bytes(whole)
    assert len(Catalogue(folder)) == 200


@pytest.mark.parametrize("change", ["id = 'A'", "lods = 0", "chunk_cells = 33"])
def test_a_row_that_makes_no_world_is_refused(folder, change):
    kept = Catalogue(folder)
    kept.create(world())
    kept.close()
    edited(folder, f"UPDATE worlds SET {change}")
    refused(folder, "damaged", change.partition(" ")[0])


def test_a_file_that_was_begun_only_is_a_new_one(folder):
    folder.mkdir(parents=True)
    (folder / FILE_NAME).touch()
    Catalogue(folder).close()
    (folder / FILE_NAME).unlink()
    edited(folder, "PRAGMA journal_mode = wal")
    kept = Catalogue(folder)
    kept.create(world())
    kept.close()


def test_there_is_no_room_for_one_more(monkeypatch):
    monkeypatch.setattr(catalogue, "WORLDS_MAX", 2)
    kept = Catalogue()
    for name in "ab":
        kept.create(world(name))
    with pytest.raises(StoreFull, match="there are 2 worlds") as caught:
        kept.create(world("c"))
    assert caught.value.values == {"worlds_max": 2}
    assert kept.create(world("b")).id == "b"
    kept.delete("a")
    kept.create(world("c"))


def test_recipes_fill_it_too(monkeypatch):
    monkeypatch.setattr(catalogue, "SOURCES_BYTES_MAX", 2 * len(TERRAIN))
    kept = Catalogue()
    for name in "ab":
        kept.create(world(name))
    with pytest.raises(StoreFull, match="recipes") as caught:
        kept.create(world("c"))
    assert caught.value.values == {"bytes_max": 2 * len(TERRAIN)}


def test_a_full_disk(folder, caplog):
    """SQLite's own limit on pages stands for the disk's: both are SQLITE_FULL."""
    kept = Catalogue(folder)
    kept._connection.pragma("max_page_count", kept._connection.pragma("page_count") + 4)
    created = 0

    def fill():
        nonlocal created
        while True:
            kept.create(world(f"w{created}"))
            created += 1

    with pytest.raises(StoreFull, match=r"^the disk is full$"):
        fill()
    assert len(kept) == created > 0
    assert kept.find(f"w{created}") is None
    assert str(folder) in caplog.text
    assert kept.delete("w0")
    kept.close()
    assert len(Catalogue(folder)) == created - 1


def test_a_disk_that_fails(folder):
    kept = Catalogue(folder)
    kept.create(world())
    kept._connection.execute("PRAGMA query_only = 1")
    for change in (lambda: kept.create(world("b")), lambda: kept.delete("a")):
        with pytest.raises(StoreError, match="readonly") as caught:
            change()
        assert not isinstance(caught.value, StoreFull)
        assert isinstance(caught.value.__cause__, apsw.Error)
    assert [one.id for one in kept.page("", 9)] == ["a"]


@pytest.fixture
def restless():
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("restless")
def test_readers_and_writers_at_once(folder):
    kept = Catalogue(folder)
    names = [f"w{number:05}" for number in range(WORLDS_WRITTEN)]

    def listed():
        found = [one.id for one in kept.page("", WORLDS_WRITTEN)]
        assert found == sorted(set(found))
        return found

    def read_until(written):
        while not all(one.done() for one in written):
            listed()

    with ThreadPoolExecutor(8) as threads:
        created = [threads.submit(kept.create, world(name)) for name in [*names, *names[::-1]]]
        read_until(created)
    assert len({one.result().epoch for one in created}) == len(names)
    assert listed() == names
    kept.close()


@pytest.mark.parametrize("name", ["", "A", "a b", "a/b", "ä", "a\n", "x" * 65, "..", "a.glb"])
def test_what_is_no_id(name):
    with pytest.raises(BadParameter) as caught:
        world(name)
    assert caught.value.values == {"id": name}


@pytest.mark.parametrize(("name", "value"), [("lods", 0), ("lods", 22), ("chunk_cells", 8), ("chunk_cells", 33)])
def test_what_is_not_built(name, value):
    with pytest.raises(BadParameter) as caught:
        world(**{name: value})
    assert caught.value.values == {name: value}


def test_the_lock_is_a_file_of_its_own(folder):
    kept = Catalogue(folder)
    assert {path.name for path in folder.iterdir()} >= {FILE_NAME, LOCK_NAME}
    assert not (folder / LOCK_NAME).read_bytes()
    kept.close()
    assert {path.name for path in folder.iterdir()} == {FILE_NAME, LOCK_NAME}


def token(recipe):
    """What a newer server's generator would be called."""
    return f"new-{recipe.seed}"


def two_worlds(folder):
    kept = Catalogue(folder)
    worlds = [kept.create(world(name, seed)) for name, seed in (("a", 1), ("b", 2))]
    kept.close()
    return worlds


def found_in(folder):
    kept = Catalogue(folder)
    worlds = kept.page("", 9)
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
    kept = Catalogue(folder)
    with pytest.raises(StoreError, match="is in use"):
        migrate(folder, [], token)
    kept.close()
