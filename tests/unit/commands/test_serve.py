import json
import re
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from chunkserver.commands import serve as command_line
from chunkserver.errors import StoreError
from chunkserver.server import Settings, create_app
from chunkserver.server.keys import parse_key
from chunkserver.server.sources import flag, variable
from tests.unit.commands.typed import run

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
    "arena_bytes": 768 << 20,
    "edit_bytes": 2 << 30,
    "log_edits": 1_000_000,
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


def text(value):
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def as_flags():
    for name, value in OTHERS.items():
        yield from (flag(name),) if value is True else (flag(name), text(value))


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
