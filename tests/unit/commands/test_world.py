import json
from contextlib import closing

import pytest

from chunkserver.commands import world as command
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.store import Store
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.world import World
from tests.unit.commands.typed import refused, run


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "worlds"


def kept(folder):
    with closing(Store(folder)) as store:
        return {world.id: world for world in store.catalogue.page("", 9)}


def test_a_world_is_created_listed_shown_and_deleted(folder, tmp_path):
    recipe = tmp_path / "ball.json"
    recipe.write_text('{"op": "sphere", "radius": 20}')
    options = ("--seed", -5, "--lods", 3, "--cells", 16, "--voxel-size", 0.25, "--data", folder)
    said = run("world", "create", "a", "--recipe", recipe, *options).stdout
    assert run("world", "create", "b", "--data", folder).exit_code == 0
    worlds = kept(folder)
    assert said == f"a is created, epoch {worlds['a'].epoch}\n"
    source = canonical({"op": "sphere", "radius": 20})
    assert worlds["a"].recipe == WorldRecipe(-5, source)
    assert worlds["a"].recipe_name == worlds["a"].recipe.digest
    assert (worlds["a"].lods, worlds["a"].chunk_cells, worlds["a"].voxel_size) == (3, 16, 0.25)
    assert (worlds["b"].recipe, worlds["b"].recipe_name) == (WorldRecipe(0, builtin("terrain")), "terrain")

    listed = run("world", "list", "--data", folder).stdout.splitlines()
    assert [line.split()[:3] for line in listed] == [
        ["world", "seed", "recipe"],
        ["a", "-5", worlds["a"].recipe_name],
        ["b", "0", "terrain"],
    ]
    as_json = json.loads(run("world", "list", "--data", folder, "--json").stdout)
    shown = json.loads(run("world", "show", "a", "--data", folder, "--json").stdout)
    assert shown == as_json[0]
    assert (shown["seed"], shown["revision"], shown["generator_is_current"]) == ("-5", "0", True)
    lines = dict(line.split(maxsplit=1) for line in run("world", "show", "a", "--data", folder).stdout.splitlines())
    assert lines == {name: str(value) for name, value in shown.items()}

    assert run("world", "delete", "a", "--yes", "--data", folder).stdout == "a is deleted\n"
    assert kept(folder).keys() == {"b"}


def test_what_another_version_has_made_is_told(folder):
    recipe = WorldRecipe(0, builtin("plane"))
    with closing(Store(folder)) as store:
        store.catalogue.create(World(id="old", recipe=recipe, recipe_name="plane", generator="0123"))
    shown = json.loads(run("world", "show", "old", "--data", folder, "--json").stdout)
    assert (shown["generator"], shown["generator_is_current"]) == ("0123", False)
    assert generator(recipe) != "0123"


def test_a_world_that_is_there_stays(folder):
    run("world", "create", "a", "--data", folder)
    before = kept(folder)["a"]
    assert refused(1, "world", "create", "a", "--seed", 1, "--data", folder) == "there is a world 'a' already"
    assert kept(folder)["a"] == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("A",), "id is 'A'"),
        (("a", "--lods", 22), "lods is 22"),
        (("a", "--cells", 8), "chunk_cells is 8"),
        (("a", "--voxel-size", 0), "voxel_size is 0.0"),
        (("a", "--seed", 1 << 63), f"seed is {1 << 63}"),
        (("a", "--recipe", "terain"), "'terain'"),
    ],
)
def test_a_world_that_cannot_be_makes_no_folder(folder, arguments, said):
    assert said in refused(2, "world", "create", *arguments, "--data", folder)
    assert not folder.exists()


ALL = [("list",), ("show", "a"), ("delete", "a", "--yes"), ("create", "b")]


@pytest.mark.parametrize("arguments", ALL)
def test_while_a_server_runs_http_is_the_way(folder, arguments):
    run("world", "create", "a", "--data", folder)
    with closing(Store(folder)):
        said = refused(1, "world", *arguments, "--data", folder)
    assert said.startswith(f"{folder} is in use: another server runs on it")
    assert "/v1/worlds" in said
    assert kept(folder).keys() == {"a"}


@pytest.mark.parametrize("arguments", ALL[:3])
def test_a_folder_without_worlds_is_left_alone(folder, arguments):
    assert FILE_NAME in refused(1, "world", *arguments, "--data", folder)
    assert not folder.exists()


@pytest.mark.parametrize("arguments", [("show", "z"), ("delete", "z", "--yes")])
def test_an_unknown_world_is_named(folder, arguments):
    run("world", "create", "a", "--data", folder)
    assert "'z'" in refused(1, "world", *arguments, "--data", folder)


@pytest.mark.parametrize("arguments", ALL)
def test_where_is_needed(arguments):
    assert "--data" in refused(2, "world", *arguments)


def test_the_folder_may_be_a_variable(folder):
    assert run("world", "create", "a", CHUNKSERVER_DATA=str(folder)).exit_code == 0
    assert kept(folder).keys() == {"a"}


@pytest.mark.parametrize(("answer", "code", "left"), [("y\n", 0, set()), ("n\n", 1, {"a"}), ("", 1, {"a"})])
def test_on_a_terminal_it_asks_before_it_deletes(folder, monkeypatch, answer, code, left):
    run("world", "create", "a", "--data", folder)
    monkeypatch.setattr(command, "_can_ask", lambda: True)
    ended = run("world", "delete", "a", "--data", folder, piped=answer)
    assert ended.exit_code == code
    assert "Delete 'a' for good?" in ended.stderr
    assert kept(folder).keys() == left


def test_a_script_says_that_it_is_sure(folder):
    run("world", "create", "a", "--data", folder)
    assert "--yes" in refused(2, "world", "delete", "a", "--data", folder, piped="y\n")
    assert kept(folder).keys() == {"a"}
