import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from chunkserver import __main__ as command_line
from chunkserver import __version__
from chunkserver.errors import StoreError
from chunkserver.server import Settings
from chunkserver.worker import Warmth

OPTIONS = {"host": "::1", "port": "8001", "workers": "3", "cache-bytes": "12345", "data": "some/folder"}
CHOSEN = Settings("::1", 8001, 3, 12345, Path("some/folder"))


@pytest.fixture
def served(monkeypatch):
    """The settings of every `serve` that the command line asks for, and where it listens."""
    found = []
    monkeypatch.setattr(command_line, "create_app", lambda settings: settings)
    monkeypatch.setattr(command_line, "listen", lambda host, port: (host, port))
    monkeypatch.setattr(command_line, "serve", lambda app, listening: found.append((app, listening)))
    for name in OPTIONS:
        monkeypatch.delenv(variable(name), raising=False)
    return found


def variable(option):
    return f"CHUNKSERVER_{option.upper().replace('-', '_')}"


def run(*arguments, **environment):
    return CliRunner().invoke(command_line.app, arguments, env=environment)


def test_the_version():
    assert run("--version").stdout == f"chunkserver {__version__}\n"


def test_the_defaults_are_those_of_the_settings(served):
    assert run("serve").exit_code == 0
    assert served == [(Settings(), (Settings().host, Settings().port))]


def test_every_option(served):
    assert run("serve", *(word for name, value in OPTIONS.items() for word in (f"--{name}", value))).exit_code == 0
    assert served == [(CHOSEN, ("::1", 8001))]


def test_every_option_is_a_variable_too(served):
    assert run("serve", **{variable(name): value for name, value in OPTIONS.items()}).exit_code == 0
    assert served == [(CHOSEN, ("::1", 8001))]
    assert set(re.findall(r"--([a-z-]+)", run("serve", "--help").stdout)) == {*OPTIONS, "help"}


@pytest.mark.parametrize(
    ("option", "value"), [("port", "-1"), ("port", "65536"), ("workers", "0"), ("cache-bytes", "-1"), ("nonsense", "1")]
)
def test_what_cannot_be_is_refused_by_name(served, option, value):
    ended = run("serve", f"--{option}", value)
    assert ended.exit_code == 2
    assert f"--{option}" in ended.stderr
    assert not served


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


def test_a_file_is_no_folder(served, tmp_path):
    (tmp_path / "file").touch()
    ended = run("serve", "--data", str(tmp_path / "file"))
    assert ended.exit_code == 2
    assert "--data" in ended.stderr
    assert not served


@pytest.mark.usefixtures("served")
def test_a_fault_while_it_serves_is_not_blamed_on_the_address(monkeypatch):
    def serve(_app, _listening):
        raise OSError("no space is left")

    monkeypatch.setattr(command_line, "serve", serve)
    ended = run("serve")
    assert isinstance(ended.exception, OSError)
    assert "cannot serve" not in ended.stderr


@pytest.mark.parametrize(("compiled", "said"), [(12, "compiled 12 functions (3.5 s)"), (0, "compiled already (3.5 s)")])
def test_warm_says_what_it_did(monkeypatch, compiled, said):
    monkeypatch.setattr(command_line, "warm", lambda: Warmth("digest", compiled, 3.5))
    assert said in run("warm").stdout
