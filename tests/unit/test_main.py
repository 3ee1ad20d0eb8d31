import json
import re
from contextlib import closing
from pathlib import Path
from typing import Any, get_args
from unittest import mock

import pytest
from typer.testing import CliRunner

from chunkserver import __main__ as command_line
from chunkserver import __version__
from chunkserver.catalogue import FILE_NAME, Catalogue, World
from chunkserver.errors import StoreError
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import Settings, create_app, log_format
from chunkserver.server.keys import Scope, digest_of_key, parse_key
from chunkserver.server.sources import CONFIG, flag, variable
from chunkserver.worker import Warmth

DIGEST = "0" * 64
OTHERS: dict[str, Any] = {
    "host": "::1",
    "port": 8001,
    "workers": 3,
    "data": Path("some/folder"),
    "cache_bytes": 12345,
    "disk_cache": Path("other/folder"),
    "disk_cache_bytes": 1 << 21,
    "jobs_waiting": 7,
    "answer_seconds": 9.5,
    "build_seconds": 4.5,
    "worker_bytes": 1 << 25,
    "connections_max": 8,
    "header_seconds": 1.5,
    "keep_alive_seconds": 2.5,
    "send_seconds": 3.5,
    "api_keys": (parse_key(f"a:read:{DIGEST}"),),
    "anonymous_read": True,
    "insecure": True,
    "cors_origins": ("https://a.example", "https://b.example"),
    "log_format": "json",
    "log_level": "error",
    "log_requests": "all",
}
"""Of each setting a value that is not its default."""
FOLDER = "folder"


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in (CONFIG, *map(variable, Settings.model_fields)):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """How the command line has the log written."""
    found = []
    monkeypatch.setattr(log_format, "install", lambda *chosen: found.append(chosen))
    return found


class App:
    """What stands for the application."""

    def __init__(self, settings):
        self.settings = settings
        self.state = mock.MagicMock()


@pytest.fixture
def served(monkeypatch):
    """The settings of every `serve` that the command line asks for, and where it listens."""
    found = []
    monkeypatch.setattr(command_line, "create_app", App)
    monkeypatch.setattr(command_line, "listen", lambda host, port: (host, port))
    monkeypatch.setattr(command_line, "serve", lambda app, listening, _: found.append((app.settings, listening)))
    return found


def run(*arguments, **environment):
    return CliRunner().invoke(command_line.app, arguments, env=environment)


def text(value):
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def as_flags():
    for name, value in OTHERS.items():
        yield from (flag(name),) if value is True else (flag(name), text(value))


def test_the_version():
    assert run("--version").stdout == f"chunkserver {__version__}\n"


def test_the_defaults_are_those_of_the_settings(served):
    assert run("serve").exit_code == 0
    assert served == [(Settings(), (Settings().host, Settings().port))]


def test_every_setting_has_another_value_here():
    assert OTHERS.keys() == Settings.model_fields.keys()
    assert all(value != getattr(Settings(), name) for name, value in OTHERS.items())


def test_every_setting_is_an_option(served, installed):
    assert run("serve", *as_flags()).exit_code == 0
    assert installed == [("json", "error")]
    assert served == [(Settings(**OTHERS), ("::1", 8001))]


def test_every_setting_is_a_variable(served):
    assert run("serve", **{variable(name): text(value) for name, value in OTHERS.items()}).exit_code == 0
    assert served == [(Settings(**OTHERS), ("::1", 8001))]


def test_every_setting_is_a_key_of_a_file(served, tmp_path):
    file = tmp_path / "settings.toml"
    values = {name: value if isinstance(value, bool | int | float) else text(value) for name, value in OTHERS.items()}
    file.write_text("".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items()))
    assert run("serve", "--config", str(file)).exit_code == 0
    assert run("serve", CHUNKSERVER_CONFIG=str(file)).exit_code == 0
    assert served == [(Settings(**OTHERS), ("::1", 8001))] * 2


def test_help_has_the_settings_and_nothing_else():
    found = set(re.findall(r"^ *(--[a-z-]+)", run("serve", "--help").stdout, re.MULTILINE))
    assert found == {*map(flag, Settings.model_fields), "--config", "--help"}


def test_an_option_takes_back_what_a_variable_says(served):
    assert run("serve", "--no-insecure", "--data", "", CHUNKSERVER_INSECURE="1", CHUNKSERVER_DATA="x").exit_code == 0
    assert served[0][0] == Settings()


@pytest.mark.parametrize(
    ("option", "value"), [("port", "-1"), ("port", "65536"), ("workers", "0"), ("cache-bytes", "-1"), ("nonsense", "1")]
)
def test_what_cannot_be_is_refused_by_name(served, option, value):
    ended = run("serve", f"--{option}", value)
    assert ended.exit_code == 2
    assert f"--{option}" in ended.stderr
    assert not served


def test_a_bad_variable_is_one_line(served):
    ended = run("serve", CHUNKSERVER_PORT="x")
    assert (ended.exit_code, served) == (2, [])
    assert re.fullmatch(r"CHUNKSERVER_PORT is 'x': .*\n", ended.stderr)


@pytest.mark.usefixtures("served")
def test_an_address_that_cannot_be_had(monkeypatch):
    def listen(_host, _port):
        raise OSError("it is taken")

    monkeypatch.setattr(command_line, "listen", listen)
    ended = run("serve", "--port", "8001")
    assert ended.exit_code == 1
    assert ended.stderr == f"cannot serve on {Settings().host} port 8001: it is taken\n"


@pytest.mark.usefixtures("served")
def test_worlds_that_cannot_be_had(monkeypatch):
    def create_app(_settings):
        raise StoreError("some/folder is in use", folder="some/folder")

    monkeypatch.setattr(command_line, "create_app", create_app)
    ended = run("serve", "--data", "some/folder")
    assert ended.exit_code == 1
    assert ended.stderr == "some/folder is in use\n"


@pytest.mark.usefixtures("served")
def test_everybody_could_write(monkeypatch):
    monkeypatch.setattr(command_line, "create_app", create_app)
    ended = run("serve", "--host", "0.0.0.0")
    assert ended.exit_code == 2
    assert re.fullmatch(r"0\.0\.0\.0 can be reached .*--insecure\n", ended.stderr)


@pytest.mark.usefixtures("served")
def test_a_fault_while_it_serves_is_not_blamed_on_the_address(monkeypatch):
    def serve(*_):
        raise OSError("no space is left")

    monkeypatch.setattr(command_line, "serve", serve)
    ended = run("serve")
    assert isinstance(ended.exception, OSError)
    assert "cannot serve" not in ended.stderr


@pytest.mark.parametrize(("compiled", "said"), [(12, "compiled 12 functions (3.5 s)"), (0, "compiled already (3.5 s)")])
def test_warm_says_what_it_did(monkeypatch, compiled, said):
    monkeypatch.setattr(command_line, "warm", lambda: Warmth("digest", compiled, 3.5))
    assert said in run("warm").stdout


def test_config_show_says_every_value_and_its_origin(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text("log_format = 'json'")
    key = f"a:read:{DIGEST}"
    options = ("config", "show", "--port", "1", "--config", str(file))
    told = json.loads(run(*options, "--json", CHUNKSERVER_API_KEYS=key).stdout)
    assert told.keys() == Settings.model_fields.keys()
    assert told["port"] == {"value": 1, "from": "--port"}
    assert told["api_keys"] == {"value": ["a:read:***"], "from": "CHUNKSERVER_API_KEYS"}
    assert told["log_format"] == {"value": "json", "from": f"log_format in {file}"}
    assert told["host"] == {"value": "127.0.0.1", "from": "default"}
    lines = run(*options, CHUNKSERVER_API_KEYS=key).stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(told)
    assert re.match(r'api_keys += \["a:read:\*\*\*"\]  # CHUNKSERVER_API_KEYS$', lines[list(told).index("api_keys")])


def test_a_new_key_is_shown_once_with_what_the_server_keeps(served):
    said = run("key", "new", "--name", "game", "--scope", "edit").stdout
    (secret,) = re.findall(r"^    (chunkserver_\S+)$", said, re.MULTILINE)
    (line,) = re.findall(r'^    api_keys = \["(.+)"\]$', said, re.MULTILINE)
    (given,) = re.findall(r"^    CHUNKSERVER_API_KEYS=(\S+)$", said, re.MULTILINE)
    assert given == line == f"game:edit:{digest_of_key(secret)}"
    assert run("serve", CHUNKSERVER_API_KEYS=line).exit_code == 0
    assert served[0][0].api_keys == (parse_key(line),)


def test_every_scope_can_be_had():
    assert get_args(command_line.Scope) == tuple(Scope)


@pytest.mark.parametrize(("name", "scope"), [("Game", "read"), ("game", "write")])
def test_a_key_that_cannot_be(name, scope):
    ended = run("key", "new", "--name", name, "--scope", scope)
    assert ended.exit_code == 2
    assert not ended.stdout


@pytest.fixture
def old(tmp_path):
    """A folder with two worlds of another generator, and one of this server's."""
    recipe = WorldRecipe(42, builtin("terrain"))
    with closing(Catalogue(tmp_path / FOLDER)) as kept:
        for name, token in (("a", "0123"), ("b", "4567"), ("c", generator(recipe))):
            kept.create(World(id=name, recipe=recipe, recipe_name="terrain", generator=token))
    return tmp_path / FOLDER


def generators(folder):
    with closing(Catalogue(folder)) as kept:
        return {world.id: world.generator for world in kept.page("", 9)}


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
    with closing(Catalogue(old)):
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
