import json

import pytest

from chunkserver.commands.given import complete_recipe
from chunkserver.errors import BadRecipe
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from tests.unit.commands.typed import refused, run
from tests.worlds import crowded


def test_the_list_has_every_builtin():
    lines = run("recipe", "list").stdout.splitlines()[1:]
    assert [line.split()[0] for line in lines] == list(BUILTINS)
    assert all(len(line.split()) > 3 for line in lines)


def test_the_list_as_json():
    listed = {row["name"]: row for row in json.loads(run("recipe", "list", "--json").stdout)}
    assert listed.keys() == BUILTINS.keys()
    assert listed["planet"]["digest"] == WorldRecipe(0, builtin("planet")).digest
    assert listed["sphere"]["parameters"] == {"radius": 48.0}
    assert listed["plane"] == {
        "name": "plane",
        "description": "Rock below y = 0.",
        "digest": WorldRecipe(0, builtin("plane")).digest,
        "parameters": {},
    }


@pytest.mark.parametrize("name", BUILTINS)
def test_a_builtin_is_shown_as_what_could_be_given(name, tmp_path):
    file = tmp_path / "shown.json"
    file.write_text(run("recipe", "show", name).stdout)
    assert canonical(file.read_bytes()) == builtin(name)


def test_an_unknown_builtin_is_named():
    assert "'terain'" in refused(2, "recipe", "show", "terain")


def test_a_new_recipe_passes_its_check(tmp_path):
    file = tmp_path / "mine.json"
    said = run("recipe", "new", file).stdout
    assert f"chunkserver recipe check {file}" in said
    told = json.loads(run("recipe", "check", file, "--json").stdout)
    recipe = WorldRecipe(0, canonical(file.read_bytes()))
    assert told["digest"] == recipe.digest
    assert (told["nodes"], told["sample_ns"] > 0) == (6, True)
    assert told["chunk_ms"] == pytest.approx(told["sample_ns"] * 35**3 / 1e6)
    lines = run("recipe", "check", file).stdout.splitlines()
    assert lines[0].startswith(f"{file} is a recipe of 6 nodes")
    assert lines[2] == f"digest  {recipe.digest}"


def test_a_new_recipe_overwrites_nothing(tmp_path):
    file = tmp_path / "mine.json"
    file.write_text("mine")
    assert refused(1, "recipe", "new", file) == f"{file} cannot be written: File exists"
    assert file.read_text() == "mine"
    assert "No such file" in refused(1, "recipe", "new", tmp_path / "none" / "mine.json")


WRONG = [
    ('{"op": "add", "a": 1, "b": {"op": "sphere", "radius": "x"}}', "at b.radius: should be a valid number"),
    ('{"op": "add", "a": 1, "b": {"op": "nope"}}', "at b: should have a known op"),
    ('{"op": "add", "a": 1}', "at b: should be there"),
    ("{", "recipe is not JSON"),
    ("[" * 5000, "nested deeper"),
    ('"terain"', "'terain'"),
    ('{"builtin": "planet", "radios": 1}', "no parameter 'radios'"),
    ("NaN", "NaN"),
    (json.dumps("x" * 70_000), "bytes; the limit is"),
    (json.dumps(crowded()), "registers"),
    ("", "recipe is not JSON"),
]


@pytest.mark.parametrize(("text", "said"), WRONG, ids=[said for _, said in WRONG])
def test_what_is_wrong_is_named_by_its_path(tmp_path, text, said):
    file = tmp_path / "mine.json"
    file.write_text(text)
    assert said in refused(2, "recipe", "check", file)
    assert said in refused(2, "recipe", "check", "-", piped=text)


def test_a_file_that_cannot_be_read(tmp_path):
    assert "is no file, and none that is built in" in refused(2, "recipe", "check", tmp_path / "none.json")
    assert refused(1, "recipe", "check", tmp_path).endswith("cannot be read: Is a directory")
    assert refused(1, "recipe", "check", "x" * 300).endswith("cannot be read: File name too long")


def test_a_recipe_that_never_ends_is_read_no_further():
    assert "the limit is 65536" in refused(2, "recipe", "check", "/dev/zero")


def test_the_shell_completes_builtins_and_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "below").mkdir()
    for name in ("planes.json", "plan.txt", "below/deep.json"):
        (tmp_path / name).touch()
    assert complete_recipe("pl") == ["plane", "planet", "planes.json"]
    assert complete_recipe("below/") == ["below/deep.json"]
    assert complete_recipe("none/") == []


def test_the_errors_of_files_are_those_of_recipes(tmp_path):
    file = tmp_path / "mine.json"
    file.write_text('{"op": "nope"}')
    with pytest.raises(BadRecipe) as refused_by_recipe:
        canonical(file.read_bytes())
    assert refused(2, "recipe", "check", file) == f"{file}: {refused_by_recipe.value.message}"
