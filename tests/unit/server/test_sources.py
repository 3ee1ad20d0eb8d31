from pathlib import Path

import pytest

from chunkserver.errors import BadSetting
from chunkserver.server.keys import Scope, mint
from chunkserver.server.settings import Settings
from chunkserver.server.sources import CONFIG, DEFAULT, choose, flag, variable


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in (CONFIG, *map(variable, Settings.model_fields)):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "chunkserver.toml"


def refusal(flags=None, config=None):
    with pytest.raises(BadSetting) as caught:
        choose(flags or {}, config)
    return caught.value.message.splitlines()


def test_nothing_is_chosen():
    settings, origins = choose({})
    assert settings == Settings()
    assert origins == dict.fromkeys(Settings.model_fields, DEFAULT)


def test_a_flag_before_a_variable_before_a_file_before_the_default(file, monkeypatch):
    file.write_text("port = 1\nworkers = 11\nhost = '::1'\ncors_origins = ['https://a.example']\n")
    monkeypatch.setenv("CHUNKSERVER_PORT", "2")
    monkeypatch.setenv("CHUNKSERVER_WORKERS", "12")
    settings, origins = choose({"port": "3"}, file)
    assert (settings.port, settings.workers, settings.host) == (3, 12, "::1")
    assert settings.cors_origins == ("https://a.example",)
    assert origins["port"] == "--port"
    assert origins["workers"] == "CHUNKSERVER_WORKERS"
    assert origins["host"] == f"host in {file}"
    assert origins["log_level"] == DEFAULT


def test_a_variable_names_the_file_and_a_flag_another(file, tmp_path, monkeypatch):
    file.write_text("port = 1")
    monkeypatch.setenv(CONFIG, str(file))
    assert choose({})[0].port == 1
    other = tmp_path / "other.toml"
    other.write_text("port = 2")
    assert choose({}, other)[0].port == 2


def test_an_empty_variable_is_none(monkeypatch):
    monkeypatch.setenv("CHUNKSERVER_PORT", "")
    monkeypatch.setenv("CHUNKSERVER_DATA", "")
    monkeypatch.setenv(CONFIG, "")
    assert choose({})[0] == Settings()


def test_a_variable_is_written_as_a_flag_is(monkeypatch):
    monkeypatch.setenv("CHUNKSERVER_CORS_ORIGINS", "https://a.example,https://b.example")
    monkeypatch.setenv("CHUNKSERVER_CACHE_BYTES", "64MiB")
    monkeypatch.setenv("CHUNKSERVER_INSECURE", "yes")
    monkeypatch.setenv("CHUNKSERVER_DATA", "some/folder")
    settings, _ = choose({})
    assert settings.cors_origins == ("https://a.example", "https://b.example")
    assert (settings.cache_bytes, settings.insecure, settings.data) == (64 << 20, True, Path("some/folder"))


def test_a_word_that_nobody_knows(file, monkeypatch):
    file.write_text("prot = 1\nlimits = {jobs = 3}\n")
    assert refusal(config=file) == [
        f"there is no setting in {file} named limits",
        f"there is no setting in {file} named prot; is port meant?",
    ]
    monkeypatch.setenv("CHUNKSERVER_WORKER", "1")
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", "is compiled code's")
    assert refusal() == ["there is no variable named CHUNKSERVER_WORKER; is CHUNKSERVER_WORKERS meant?"]


def test_a_bad_value_is_named_as_it_was_given(file, monkeypatch):
    file.write_text("workers = 0")
    monkeypatch.setenv("CHUNKSERVER_ANSWER_SECONDS", "soon")
    port, workers, seconds = sorted(refusal({"port": "x" * 1000}, file), key=lambda line: line[:3] != "--p")
    assert port.startswith("--port is 'xxx")
    assert len(port) < 250
    assert f"workers in {file} is 0" in (workers, seconds)[0] + (workers, seconds)[1]
    assert any(line.startswith("CHUNKSERVER_ANSWER_SECONDS is 'soon'") for line in (workers, seconds))


def test_a_key_is_never_repeated(monkeypatch):
    secret, kept = mint("game", Scope.READ)
    for given in (secret, f"game:read:{secret}", f"{kept} {kept}", f"game:write:{secret}"):
        monkeypatch.setenv("CHUNKSERVER_API_KEYS", given)
        (line,) = refusal()
        assert secret not in line
        assert kept.digest not in line


@pytest.mark.parametrize(
    ("text", "why"), [("port = ", "is no TOML"), ("port = 1\nport = 2", "is no TOML"), (b"\xff", "is no TOML")]
)
def test_what_is_no_toml(file, text, why):
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    (line,) = refusal(config=file)
    assert str(file) in line
    assert why in line


def test_a_file_that_cannot_be_read(file, tmp_path):
    for path in (file, tmp_path):
        (line,) = refusal(config=path)
        assert line.startswith(f"{path} cannot be read: ")


def test_spellings():
    assert (flag("cache_bytes"), variable("cache_bytes")) == ("--cache-bytes", "CHUNKSERVER_CACHE_BYTES")
