import sys
from concurrent.futures import ThreadPoolExecutor

import apsw
import pytest

from chunkserver.errors import BadParameter, StoreError, StoreFull
from chunkserver.recipe import builtin, canonical
from chunkserver.store import Store, catalogue
from chunkserver.world import EPOCH_BYTES
from tests.scale import count
from tests.unit.store.worlds import TERRAIN, edited, refused, world

WORLDS_WRITTEN = count(20_000)


def test_what_was_created_is_there_after_a_restart(folder):
    worlds = [
        world("b", -(2**63), builtin("planet"), voxel_size=0.1, lods=21, chunk_cells=64),
        world("a", 2**63 - 1, canonical({"op": "sphere", "radius": 20})),
        world("_-0", 0),
    ]
    first = Store(folder)
    for one in worlds:
        assert first.catalogue.create(one) is one
    first.close()
    second = Store(folder)
    assert [second.catalogue.find(one.id) for one in worlds] == worlds
    assert len(second.catalogue) == 3
    second.close()


def test_without_a_folder_it_lasts_as_long_as_the_catalogue(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = Store()
    first.catalogue.create(world())
    assert first.catalogue.find("a")
    first.close()
    assert Store().catalogue.find("a") is None
    assert not list(tmp_path.iterdir())


def test_an_id_belongs_to_the_first_until_it_is_deleted(folder):
    kept = Store(folder)
    first, second = world(seed=1), world(seed=2)
    assert kept.catalogue.create(first) is first
    assert kept.catalogue.create(second) is first
    assert kept.catalogue.delete("a") is first
    assert kept.catalogue.delete("a") is kept.catalogue.find("a") is None
    assert kept.catalogue.create(second) is second
    kept.close()
    again = Store(folder)
    assert again.catalogue.find("a") == second
    again.catalogue.delete("a")
    again.close()
    assert not len(Store(folder).catalogue)


def test_each_world_has_an_epoch_of_its_own():
    assert world().epoch != world().epoch
    assert len(bytes.fromhex(world().epoch)) == EPOCH_BYTES


def test_pages():
    kept = Store()
    for name in ("c", "a-", "a", "b", "_"):
        kept.catalogue.create(world(name))
    assert [one.id for one in kept.catalogue.page("", 10)] == ["_", "a", "a-", "b", "c"]
    assert [one.id for one in kept.catalogue.page("", 2)] == ["_", "a"]
    assert [one.id for one in kept.catalogue.page("a", 2)] == ["a-", "b"]
    assert [one.id for one in kept.catalogue.page("aa", 10)] == ["b", "c"], (
        "the last one seen may have been deleted since"
    )
    assert kept.catalogue.page("c", 10) == []


@pytest.mark.parametrize("change", ["id = 'A'", "lods = 0", "chunk_cells = 33"])
def test_a_row_that_makes_no_world_is_refused(folder, change):
    kept = Store(folder)
    kept.catalogue.create(world())
    kept.close()
    edited(folder, f"UPDATE worlds SET {change}")
    refused(folder, "damaged", change.partition(" ")[0])


def test_there_is_no_room_for_one_more(monkeypatch):
    monkeypatch.setattr(catalogue, "WORLDS_MAX", 2)
    kept = Store()
    for name in "ab":
        kept.catalogue.create(world(name))
    with pytest.raises(StoreFull, match="there are 2 worlds") as caught:
        kept.catalogue.create(world("c"))
    assert caught.value.values == {"worlds_max": 2}
    assert kept.catalogue.create(world("b")).id == "b"
    kept.catalogue.delete("a")
    kept.catalogue.create(world("c"))


def test_recipes_fill_it_too(monkeypatch):
    monkeypatch.setattr(catalogue, "SOURCES_BYTES_MAX", 2 * len(TERRAIN))
    kept = Store()
    for name in "ab":
        kept.catalogue.create(world(name))
    with pytest.raises(StoreFull, match="recipes") as caught:
        kept.catalogue.create(world("c"))
    assert caught.value.values == {"bytes_max": 2 * len(TERRAIN)}


def test_a_full_disk(folder, caplog):
    """SQLite's own limit on pages stands for the disk's: both are SQLITE_FULL."""
    kept = Store(folder)
    kept._database._writer.pragma("max_page_count", kept._database._writer.pragma("page_count") + 4)
    created = 0

    def fill():
        nonlocal created
        while True:
            kept.catalogue.create(world(f"w{created}"))
            created += 1

    with pytest.raises(StoreFull, match=r"^the disk is full$"):
        fill()
    assert len(kept.catalogue) == created > 0
    assert kept.catalogue.find(f"w{created}") is None
    assert str(folder) in caplog.text
    assert kept.catalogue.delete("w0")
    kept.close()
    assert len(Store(folder).catalogue) == created - 1


def test_a_disk_that_fails(folder):
    kept = Store(folder)
    kept.catalogue.create(world())
    kept._database._writer.pragma("query_only", True)
    for change in (lambda: kept.catalogue.create(world("b")), lambda: kept.catalogue.delete("a")):
        with pytest.raises(StoreError, match="readonly") as caught:
            change()
        assert not isinstance(caught.value, StoreFull)
        assert isinstance(caught.value.__cause__, apsw.Error)
    assert [one.id for one in kept.catalogue.page("", 9)] == ["a"]


@pytest.fixture
def restless():
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("restless")
def test_readers_and_writers_at_once(folder):
    kept = Store(folder)
    names = [f"w{number:05}" for number in range(WORLDS_WRITTEN)]

    def listed():
        found = [one.id for one in kept.catalogue.page("", WORLDS_WRITTEN)]
        assert found == sorted(set(found))
        return found

    def read_until(written):
        while not all(one.done() for one in written):
            listed()

    with ThreadPoolExecutor(8) as threads:
        created = [threads.submit(kept.catalogue.create, world(name)) for name in [*names, *names[::-1]]]
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
