"""The program as a whole: its table of commands, what it imports, how it fails."""

import os
import re
import subprocess
import sys

import pytest
import typer.main

from chunkserver import __version__
from chunkserver.__main__ import app
from tests.unit.commands.typed import refused, run

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
GROUPS = {name: command for name, command in COMMANDS.items() if hasattr(command, "commands")}
HEAVY = ("numba", "fastapi", "uvicorn", "trimesh", "apsw")
LIGHT = [("--version",), ("--help",), ("recipe", "list"), ("recipe", "show", "planet"), ("nonsense",)]


def test_the_version():
    assert run("--version").stdout == f"chunkserver {__version__}\n"


def test_the_table_says_what_the_commands_say():
    listed = dict(re.findall(r"^  (\w+)  +(\S.*)$", run("--help").stdout.partition("Commands:")[2], re.MULTILINE))
    assert listed.keys() == COMMANDS.keys()
    for name, line in listed.items():
        told = " ".join(COMMANDS[name].help.partition("\n\n")[0].split())
        assert line == told or (name not in GROUPS and told.startswith(line.rstrip("."))), name


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_has_help(name):
    ended = run(name, "--help")
    assert (ended.exit_code, ended.stderr) == (0, "")
    assert re.match(rf"Usage: \w+ {name} ", ended.stdout)


def test_every_option_and_argument_has_help():
    commands = [command for name, command in COMMANDS.items() if name not in GROUPS]
    commands += [command for group in GROUPS.values() for command in group.commands.values()]
    silent = [parameter.name for command in commands for parameter in command.params if not parameter.help]
    assert len(commands) == 22
    assert silent == []


def imported(*arguments, **environment):
    """Return which of the heavy packages Python imports for a command, or to complete one."""
    code = f"""
import sys
from chunkserver.__main__ import app
try:
    app({list(arguments)!r}, prog_name="chunkserver")
except SystemExit:
    pass
print(*(set({HEAVY!r}) & sys.modules.keys()), file=sys.stderr)
"""
    command, around = [sys.executable, "-c", code], {**os.environ, **environment}
    ended = subprocess.run(command, env=around, capture_output=True, text=True, timeout=60, check=True)
    return set(ended.stderr.splitlines()[-1].split())


@pytest.mark.parametrize("words", ["chunkserver ", "chunkserver recipe show p"])
def test_completion_imports_nothing_heavy(words):
    count = str(len(words.split(" ")) - 1)
    assert imported(_CHUNKSERVER_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=count) == set()


@pytest.mark.parametrize("arguments", LIGHT)
def test_what_is_light_imports_nothing_heavy(arguments):
    assert imported(*arguments) == set()


def test_what_is_heavy_is_seen():
    assert imported("mesh", "--help") == {"numba"}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("nonsense",), "nonsense"),
        (("mesh", "--nonsense"), "--nonsense"),
        (("recipe", "show"), "NAME"),
        (("recipe", "nonsense"), "nonsense"),
        (("key", "new", "--name", "a", "--scope", "nonsense"), "nonsense"),
        (("mesh", "a.glb", "--lod", "x"), "'x'"),
        (("mesh", "a.glb", "--chunk", "1", "2"), "--chunk"),
    ],
)
def test_what_is_typed_wrong_is_named_in_one_line(arguments, named):
    said = refused(2, *arguments)
    assert named in said
    assert said.endswith("--help") or "requires" in said


def test_a_fault_of_ours_keeps_its_traceback(monkeypatch):
    def broken():
        raise ZeroDivisionError

    monkeypatch.setattr("chunkserver.worker.warm", broken)
    assert isinstance(run("warm").exception, ZeroDivisionError)


def test_ctrl_c_is_no_failure(monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("chunkserver.worker.warm", interrupted)
    ended = run("warm")
    assert (ended.exit_code, ended.stdout, ended.stderr) == (130, "", "")
