"""docs/command-line.md against the program: every command, option, member and figure; and its examples, typed."""

import json
import re
import shlex
from pathlib import Path

import pytest
import typer.main

from chunkserver.__main__ import app
from chunkserver.commands.building import TRIANGLES_MAX
from chunkserver.commands.edit import EDIT_BYTES_MAX
from chunkserver.commands.inspect import FILE_BYTES_MAX
from chunkserver.commands.log import SHOWN_DEFAULT, SHOWN_MAX
from chunkserver.commands.log_file import LINE_BYTES_MAX
from chunkserver.commands.welding import CHUNKS_MAX
from chunkserver.recipe import RECIPE_DEFAULT
from chunkserver.server import Settings, edits
from chunkserver.server.sources import flag
from tests.contract.test_operating import commands_of
from tests.unit.commands.typed import refused, run

PAGE = (Path(__file__).parents[2] / "docs/command-line.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([^`\n]+)`", PAGE))
COMMANDS = commands_of(typer.main.get_command(app))
SETTINGS = {flag(name) for name in Settings.model_fields} | {"--config"}
BLOCKS = re.findall(r"^```sh\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
FILES = re.findall(r"^```json (\S+)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]
OWN = {"mesh", "inspect", "recipe", "world", "edit", "log", "verify"}
"""Whose options are told here; those of the others are settings, or told in docs/operating.md."""


def options_of(words):
    return {option for parameter in COMMANDS[words].params for option in parameter.opts if option.startswith("--")}


def section(title):
    (found,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    return found


def members(title):
    """Return the names in the first column of the tables of a section."""
    rows = re.findall(r"^\| (`.*?) \|", section(title), re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)}


def test_every_command():
    words = {words.removeprefix("chunkserver ") for words in COMMANDS}
    assert len(words) == 22
    assert {name for name in words if {name, f"chunkserver {name}"} & NAMED} == words
    typed = {name for name in NAMED if name.startswith("chunkserver ") and "--" not in name}
    assert typed <= COMMANDS.keys(), "no command that is none"


def test_every_option():
    own = {option for words in COMMANDS if words.split()[1] in OWN for option in options_of(words)}
    told = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", PAGE))
    assert own - SETTINGS - {"--help"} <= told
    assert told <= own | SETTINGS | {"--help", "--version", "--install-completion", "--show-completion"}


def test_the_figures_are_those_of_the_code():
    for figure in (CHUNKS_MAX, TRIANGLES_MAX, FILE_BYTES_MAX):
        assert f"{figure:,}" in PAGE
    defaults = {parameter.opts[0]: parameter.default for parameter in COMMANDS["chunkserver mesh"].params}
    told = dict(re.findall(r"^\| `(--[a-z-]+)` \| .* \| `(.*)` \|$", section("Meshes"), re.MULTILINE))
    assert told == {name: str(defaults[name]) for name in told}
    assert len(told) == 5
    assert defaults["--recipe"] == RECIPE_DEFAULT


@pytest.fixture(scope="module")
def typed(tmp_path_factory):
    """What each line of the page says, typed one after the other in an empty folder."""
    said = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("typed"))
        for name, text in FILES:
            Path(name).write_text(text)
        for line in LINES:
            program, *words = shlex.split(line)
            assert program == "chunkserver"
            ended = run(*words)
            assert (ended.exit_code, ended.stderr) == (0, ""), (line, ended.output)
            said[line] = ended.stdout
        yield said


def test_what_is_typed_works(typed):
    assert len(typed) == len(LINES) >= 14
    assert all(typed.values())
    assert "it is what docs/wire says" in typed["chunkserver inspect chunk.mesh"]


def test_every_member_of_what_is_written(typed):
    (line,) = [line for line in typed if "chunk.glb --chunk" in line]
    told = json.loads(run(*shlex.split(line)[1:], "--json").stdout)
    assert members("Meshes") == told.keys()
    assert {*told["chunks"]} <= NAMED


def test_every_member_of_what_is_in_a_file(typed):
    facts = [json.loads(run("inspect", file, "--json").stdout) for file in ("chunk.mesh", "chunk.glb")]
    assert members("What is in a file") == {name for fact in facts for name in fact} - {"faults"}
    inner = {
        name for fact in facts for row in (*fact["blocks"], fact["bounds"], fact["bounds"]["metres"]) for name in row
    }
    assert inner | {"faults", "where", "what"} <= NAMED
    assert typed["chunkserver inspect chunk.glb --json"] == json.dumps(facts[1], indent=2) + "\n"


def test_every_member_of_recipes_and_worlds(typed):
    (shown,) = [said for line, said in typed.items() if "world show" in line]
    checked = json.loads(run("recipe", "check", "mine.json", "--json").stdout)
    assert {*json.loads(shown), *checked} <= NAMED


def test_every_member_of_an_answer_to_an_edit(typed):
    (answer,) = [json.loads(said) for line, said in typed.items() if "edit dug" in line and "--json" in line]
    assert {*answer} <= NAMED
    assert (answer["revision"], answer["duplicate"]) == ("1", True)
    assert f"{EDIT_BYTES_MAX:,} bytes" in section("Edits")
    assert EDIT_BYTES_MAX == edits.BODY_BYTES_MAX


def test_every_member_of_a_log(typed):
    (told,) = [json.loads(said) for line, said in typed.items() if "log show" in line and "--json" in line]
    assert {*told, *told["edits"][0]} <= NAMED
    assert f"the last {SHOWN_DEFAULT}" in section("The log of edits")
    assert f"{SHOWN_MAX:,} at most" in section("The log of edits")


def test_every_member_of_an_exported_log(typed):
    page = (Path(__file__).parents[2] / "docs/edits/log-file.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_]+)`", page))
    assert "chunkserver log export dug dug.ndjson --data worlds" in typed
    first, *edits, last = [json.loads(line) for line in Path("dug.ndjson").read_text().splitlines()]
    assert first["chunkserver_log"] == 1
    assert {*first, *first["world"], *edits[0], *last, *last["end"]} <= named
    assert f"{LINE_BYTES_MAX:,} bytes" in page


def test_what_is_wrong_is_said_like_that(typed, tmp_path):
    del typed
    (fault,) = re.findall(r"^chunk.mesh: (byte .*)$", PAGE, re.MULTILINE)
    file = bytearray(Path("chunk.mesh").read_bytes())
    place, vertices = (int(found) for found in re.findall(r"byte (\d+): .* (\d+)$", fault)[0])
    file[place : place + 2] = vertices.to_bytes(2, "little")
    (tmp_path / "broken.mesh").write_bytes(file)
    ended = run("inspect", tmp_path / "broken.mesh")
    assert (ended.exit_code, ended.stderr) == (1, f"{tmp_path / 'broken.mesh'}: {fault}\n")

    (wrong,) = re.findall(r"^mine.json: (recipe: at .*)$", PAGE, re.MULTILINE)
    recipe = json.loads(Path("mine.json").read_text())
    recipe["a"]["height"]["b"] = "x"
    (tmp_path / "mine.json").write_text(json.dumps(recipe))
    assert refused(2, "recipe", "check", tmp_path / "mine.json") == f"{tmp_path / 'mine.json'}: {wrong}"
