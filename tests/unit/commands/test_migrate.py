from contextlib import closing

import pytest

from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Store
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.world import World
from tests.unit.commands.typed import run

FOLDER = "folder"


@pytest.fixture
def old(tmp_path):
    """A folder with two worlds of another generator, and one of this server's."""
    recipe = WorldRecipe(42, builtin("terrain"))
    with closing(Store(tmp_path / FOLDER)) as kept:
        for name, token in (("a", "0123"), ("b", "4567"), ("c", generator(recipe))):
            kept.catalogue.create(World(id=name, recipe=recipe, recipe_name="terrain", generator=token))
    return tmp_path / FOLDER


def generators(folder):
    with closing(Store(folder)) as kept:
        return {world.id: world.generator for world in kept.catalogue.page("", 9)}


def test_migrate_says_what_it_moved(old):
    current = generators(old)["c"]
    ended = run("migrate", "--data", str(old), "a", "c")
    assert ended.exit_code == 0
    first, last = ended.stdout.splitlines()
    assert first.startswith(f"a: from generator 0123 to {current}")
    assert last == "1 worlds moved"
    assert generators(old) == {"a": current, "b": "4567", "c": current}
    assert run("migrate", "--all", CHUNKSERVER_DATA=str(old)).stdout.startswith("b: from generator 4567")
    assert set(generators(old).values()) == {current}


def test_migrate_is_refused_while_a_server_runs(old):
    with closing(Store(old)):
        ended = run("migrate", "--data", str(old), "--all")
    assert (ended.exit_code, ended.stderr) == (1, f"{old} is in use: another server runs on it\n")
    assert generators(old)["a"] == "0123"


def test_migrate_makes_no_folder(tmp_path):
    ended = run("migrate", "--data", str(tmp_path / FOLDER), "--all")
    assert (ended.exit_code, ended.stderr.count("\n")) == (1, 1)
    assert FILE_NAME in ended.stderr
    assert not (tmp_path / FOLDER).exists()


@pytest.mark.parametrize("arguments", [("a", "--all", "--data", "x"), ("--data", "x"), ("--all",)])
def test_migrate_is_told_what_and_where(arguments):
    assert run("migrate", *arguments).exit_code == 2
