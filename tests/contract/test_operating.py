"""docs/operating.md names every setting, route of operations, metric and problem, and none that there is not; what it
tells people to type is typed, and what it tells them to write into files is parsed."""

import configparser
import json
import re
import shlex
import tomllib
from contextlib import closing
from pathlib import Path

import httpx2
import pytest
import yaml
from pydantic import ByteSize
from typer.main import get_command
from typer.testing import CliRunner

from chunkserver import worker
from chunkserver.__main__ import app
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import Settings, create_app, log_format
from chunkserver.server.access import NEEDS
from chunkserver.server.connections import ConnectionLimits
from chunkserver.server.metrics import TABLE
from chunkserver.server.problems import PROBLEMS, TYPE_PREFIX
from chunkserver.server.protocol import GAVE_WAY, Wait
from chunkserver.server.request_log import LINES_AT_ONCE_MAX, LINES_PER_SECOND_MAX
from chunkserver.server.run import DESCRIPTORS_BESIDE, GRACE_SECONDS
from chunkserver.server.sources import CONFIG, flag, variable
from chunkserver.store import Store
from chunkserver.worker import Warmth
from chunkserver.world import World
from tests.serving import serving

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/operating.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([^`\n]+)`", PAGE))
DATA = "/var/lib/chunkserver"


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def rows(heading):
    """The cells of the first table behind a heading, without its two rows of head."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    table = re.findall(r"^\|(.*)\|$", section, re.MULTILINE)[2:]
    return [[cell.strip() for cell in row.split("|")] for row in table]


def lines(*first_words):
    """The lines of shell that begin with one of these words."""
    return [line for block in blocks("sh") for line in block.splitlines() if line.split()[0] in first_words]


def default(field):
    """Return a setting's default as the page writes it."""
    value = field.get_default()
    match value:
        case _ if field.default_factory:
            return "one for each core"
        case bool():
            return "yes" if value else "no"
        case None | ():
            return "none"
        case tuple():
            return f"`{' '.join(value)}`"
        case ByteSize():
            return value.human_readable(separator=" ").replace(".0", "")
        case int() | float():
            return f"{value:g}"
        case _:
            return f"`{value}`"


def test_every_setting_and_no_other():
    assert rows("Settings") == [
        [f"`{name}`", default(field), field.description] for name, field in Settings.model_fields.items()
    ]


def test_every_metric_and_no_other():
    told = [[cell for cell in row if cell] for row in rows("Metrics")]
    assert told == [
        [
            cell
            for cell in (f"`{row.name}`", row.kind, ", ".join(f"`{label}`" for label in row.labels), row.says)
            if cell
        ]
        for row in TABLE
    ]


def test_every_problem_and_no_other():
    assert sorted((name, status) for name, status, _ in rows("When it refuses")) == sorted(
        {(f"`{row.name}`", str(row.status)) for row in PROBLEMS.values()}
    )
    assert f"`{TYPE_PREFIX}`" in PAGE


def test_every_way_in_which_a_connection_ends():
    whys = {wait.value for wait in Wait} - {Wait.ANSWER.value} | {GAVE_WAY}
    assert whys <= NAMED


PAGES = {"/", "/about", "/assets/{name}"}
"""For people."""


def test_every_route_of_operations():
    operations = create_app(Settings()).openapi()["paths"].items()
    routes = {path for path, methods in operations if "operations" in methods.get("get", {"tags": ()})["tags"]} - PAGES
    assert routes == {"/livez", "/readyz", "/metrics"}
    assert routes <= NAMED
    assert {f"`{scope}`" for scope in {row.scope for row in NEEDS if row.scope}} == {
        f"`{name}`" for name in re.findall(r"^\| `(read|edit|admin)` \|", PAGE, re.MULTILINE)
    }


def test_every_variable_exists():
    known = {*map(variable, Settings.model_fields), CONFIG, "CHUNKSERVER_CACHE_DIR"}
    assert set(re.findall(r"\bCHUNKSERVER_[A-Z_]+", PAGE)) <= known


def commands_of(command, name="chunkserver"):
    """Each command of the command line, by the words that call it."""
    if not hasattr(command, "commands"):
        return {name: command}
    below = (commands_of(inner, f"{name} {word}") for word, inner in command.commands.items())
    return {words: one for found in below for words, one in found.items()}


def test_every_option_and_command():
    commands = commands_of(get_command(app))
    for words in ("serve", "warm", "migrate", "config show", "key new", "world backup", "world restore", "verify"):
        assert f"chunkserver {words}" in commands
        assert f"chunkserver {words}" in PAGE
    options = {option for found in commands.values() for parameter in found.params for option in parameter.opts}
    assert set(re.findall(r"`(--[a-z-]+)`", PAGE)) <= options | set(map(flag, Settings.model_fields))


def test_the_figures_are_those_of_the_code():
    limits = ConnectionLimits()
    assert f"answers what is in flight for up to {GRACE_SECONDS} s" in PAGE
    assert f"`connections_max` and {DESCRIPTORS_BESIDE:,} more" in PAGE
    assert f"{LINES_AT_ONCE_MAX} lines at once, {LINES_PER_SECOND_MAX} a second" in PAGE
    assert f"longer than {limits.url_bytes_max >> 10} KiB" in PAGE
    assert f"more than {limits.head_bytes_max >> 10} KiB, or more than {limits.head_fields_max} fields" in PAGE
    assert f"its resource, or {limits.body_bytes_max >> 20} MiB" in PAGE
    proxy = [float(seconds) for seconds in re.findall(r"keepalive(?:_timeout)? (\d+)s", PAGE)]
    assert len(proxy) == 2
    assert max(proxy) < limits.keep_alive_seconds, "else a proxy sends on a connection that is being closed"


def test_the_file_of_settings():
    (block,) = blocks("toml")
    chosen = Settings(**tomllib.loads(block))
    assert len(chosen.api_keys) == 2
    assert chosen.anonymous_read


def test_the_alerts_ask_for_what_there_is():
    (block,) = blocks("yaml")
    known = {row.name: row for row in TABLE}
    rules = yaml.safe_load(block)["groups"][0]["rules"]
    asked = [name for rule in rules for name in re.findall(r"\bchunkserver_[a-z_]+", rule["expr"])]
    asked += re.findall(r"^    .*?\b(chunkserver_[a-z_]+)", PAGE, re.MULTILINE)
    assert len(asked) >= len(rules) + 2
    for name in asked:
        row = known.get(name) or known[name.removesuffix("_bucket")]
        assert (row.kind == "histogram") == name.endswith("_bucket")
    for rule in rules:
        for label in re.findall(r'([a-z]+)="', rule["expr"]):
            assert any(label in known[name.removesuffix("_bucket")].labels for name in known if name in rule["expr"])


def test_the_unit_of_systemd():
    (block,) = blocks("ini")
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(block)
    service = unit["Service"]
    assert float(service["TimeoutStopSec"]) > GRACE_SECONDS
    assert service["RestartPreventExitStatus"] == "2"
    assert int(service["LimitNOFILE"]) >= ConnectionLimits().connections_max + DESCRIPTORS_BESIDE
    program, *arguments = shlex.split(service["ExecStart"])
    assert Path(program).name == "chunkserver"
    assert arguments[:2] == ["serve", "--config"]
    assert service["Environment"].partition("=")[0] == "CHUNKSERVER_CACHE_DIR"


def test_a_line_of_the_log():
    (text,), (line,) = blocks("text"), blocks("json")
    told = json.loads(line)
    rest = {name: value for name, value in told.items() if name not in ("time", "level", "logger", "message")}
    said = " ".join(f"{name}={value}" for name, value in rest.items())
    assert text.strip() == f"{told['time']} {told['level']} {told['logger']}: {told['message']} {said}"


def test_the_proxies_balance_their_braces():
    for block in (*blocks("nginx"), *blocks("caddyfile")):
        assert block.count("{") == block.count("}") > 2
        assert "127.0.0.1:8000" in block
    (nginx,) = blocks("nginx")
    statements = [line for line in map(str.strip, nginx.splitlines()) if line and line[0] not in "#}"]
    assert all(line.endswith((";", "{")) for line in statements)


def test_the_files_of_docker():
    for line in lines("docker"):
        files = re.findall(r"--file (\S+)", line)
        assert files
        assert all((ROOT / file).is_file() for file in files)


@pytest.fixture
def folder(tmp_path):
    """A folder of worlds, one of which another generator has made."""
    recipe = WorldRecipe(42, builtin("terrain"))
    with closing(Store(tmp_path / "worlds")) as kept:
        for name, token in (("my-world", "0123"), ("other", generator(recipe))):
            kept.catalogue.create(World(id=name, recipe=recipe, recipe_name="terrain", generator=token))
    return tmp_path / "worlds"


def typed(line, folder):
    """Return what a line of shell says; our own command line runs in this process: that is faster."""
    program, *words = shlex.split(line.replace(DATA, str(folder)))
    if program == "mv":
        Path(words[0]).rename(words[1])
        return ""
    assert program == "chunkserver"
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 0, (line, ended.output)
    return ended.stdout


def epochs(folder):
    with closing(Store(folder)) as kept:
        return {world.id: world.epoch for world in kept.catalogue.page("", 9)}


def test_what_is_typed_works(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(log_format, "install", lambda *_: None)
    monkeypatch.setattr(worker, "warm", lambda: Warmth("digest", 0, 0.0))
    typed_lines = [line for line in lines("chunkserver", "mv") if " serve" not in line]
    assert len(typed_lines) >= 9
    before = epochs(folder)
    assert before.keys() == {"my-world", "other"}
    for line in typed_lines:
        said = typed(f"{line} other" if " verify " in line else line, folder)  # not the one of another generator
        assert said or line.startswith("mv "), line
        if " migrate " in line and "my-world" in line:
            assert "my-world: from generator 0123" in said
    after = epochs(folder)
    assert after.keys() == before.keys()
    assert not {*after.values()} & {*before.values()}
    assert epochs(tmp_path / "worlds-before") == before


def test_what_is_served(folder, tmp_path):
    (line,) = [line for line in lines("chunkserver") if " serve" in line]
    options = shlex.split(line.replace(DATA, str(folder)))[2:]
    with serving(tmp_path / "log", *options, "--log-format", "json", "--workers", "1", "--port", "0") as server:
        (backup,) = [line for line in lines("chunkserver") if " backup " in line]
        assert typed(backup, folder)
        for asked in lines("curl"):
            url = asked.split()[-1].replace("http://127.0.0.1:8000", server.url)
            assert httpx2.get(url).status_code == 200
        failed = httpx2.get(f"{server.url}/v1/seeds/x", headers={"X-Request-Id": "mine"})
        assert failed.json()["instance"].endswith("mine")
        metrics = httpx2.get(f"{server.url}/metrics").text
        for row in TABLE:
            if not (row.labels or row.name.startswith("chunkserver_disk")):
                assert f"# HELP {row.name.removesuffix('_total')}" in metrics
        for name in re.findall(r"`(process_[a-z_]+)`", PAGE):
            assert f"\n{name} " in metrics
    assert (tmp_path / "worlds-backup.sqlite").stat().st_size > 0
    told = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [line["status"] for line in told if line.get("request") == "mine"] == [422]
