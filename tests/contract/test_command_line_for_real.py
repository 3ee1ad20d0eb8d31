"""The program as it is typed: in a process of its own, beside a real server, interrupted, piped, on a terminal."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time

import httpx2
import pytest
from typer.testing import CliRunner

from chunkserver.__main__ import app
from tests.serving import serving
from tests.unit.commands.typed import refused, run

PROGRAM = (sys.executable, "-m", "chunkserver")
SECONDS_MAX = 120.0
CHUNKS = [
    ("terrain", 42, 0, (0, -1, 3)),
    ("planet", -1, 2, (1, 1, 0)),
    ("hills", 2**63 - 1, 5, (-3, -1, 2)),
]
FORMS = [
    ("glb", (), ""),
    ("glb", ("--frame", "box"), "&frame=chunk"),
    ("mesh", (), ""),
    ("mesh", ("--profile", "f32"), "&profile=f32"),
]


DUG = {"strokes": [{"op": "carve", "shape": "sphere", "center": [48, 3, -2], "radius": 7}]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with one world, created and edited by the command line."""
    made = tmp_path_factory.mktemp("server") / "worlds"
    assert run("world", "create", "mine", "--seed", 7, "--recipe", "sphere", "--data", made).exit_code == 0
    ended = run("edit", "mine", "-", "--key", "dig", "--data", made, piped=json.dumps(DUG))
    assert ended.stdout == "mine: revision 1, 1 stroke\n"
    return made


@pytest.fixture(scope="module")
def shown(folder):
    """What the command line says of that world, while no server runs."""
    return json.loads(run("world", "show", "mine", "--data", folder, "--json").stdout)


@pytest.fixture(scope="module")
def server(folder, shown):
    del shown
    with serving(folder.parent / "log", "--workers", "1", "--data", str(folder)) as running:
        yield running


def typed(*arguments, cwd=None, piped=None):
    """Return how the program ended: bytes on stdout, text on stderr."""
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, input=piped, capture_output=True, timeout=SECONDS_MAX, check=False)


@pytest.mark.parametrize(("form", "options", "query"), FORMS)
@pytest.mark.parametrize(("recipe", "seed", "lod", "place"), CHUNKS)
def test_a_chunk_is_what_the_server_sends(server, tmp_path, recipe, seed, lod, place, form, options, query):
    file = tmp_path / f"chunk.{form}"
    world = ("--recipe", recipe, "--seed", seed, "--lod", lod, "--chunk", *place)
    assert run("mesh", file, *world, *options).exit_code == 0
    path = "/".join(map(str, (lod, *place)))
    answer = httpx2.get(f"{server.url}/v1/seeds/{seed}/chunks/{path}.{form}?recipe={recipe}{query}")
    assert answer.status_code == 200
    assert file.read_bytes() == answer.content


def test_a_chunk_in_a_process_of_its_own(server, tmp_path):
    ended = typed("mesh", "chunk.glb", "--chunk", 0, -1, 3, "--seed", 42, cwd=tmp_path)
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert ended.stdout.startswith(b"chunk.glb: 1 chunk, ")
    body = (tmp_path / "chunk.glb").read_bytes()
    assert httpx2.get(f"{server.url}/v1/seeds/42/chunks/0/0/-1/3.glb").content == body
    told = typed("inspect", "-", "--json", piped=body)
    assert (told.returncode, told.stderr) == (0, b"")
    assert json.loads(told.stdout)["faults"] == []
    cut = typed("inspect", "-", piped=body[:-8])
    assert cut.returncode == 1
    assert re.fullmatch(rb"-: byte 8: the length is \d+; the file has \d+ bytes\n", cut.stderr)


def test_a_world_that_is_created_here_is_served(server, shown):
    told = httpx2.get(f"{server.url}/v1/worlds/mine").json()
    both = shown.keys() & told.keys() - {"recipe"}
    assert len(both) >= 8
    assert {name: told[name] for name in both} == {name: shown[name] for name in both}


def test_an_edit_that_is_made_here_is_served_and_known_by_its_key(server):
    worlds = f"{server.url}/v1/worlds"
    again = httpx2.post(f"{worlds}/mine/edits", json=DUG, headers={"Idempotency-Key": "dig"}).json()
    assert (again["revision"], again["duplicate"]) == ("1", True)
    httpx2.post(worlds, json={"id": "twin", "seed": "7", "recipe": "sphere"}).raise_for_status()
    twin = httpx2.post(f"{worlds}/twin/edits", json=DUG).json()
    assert again["stale"] == twin["stale"] != []
    chunks = [httpx2.get(f"{worlds}/{name}/chunks/0/1/0/-1.mesh") for name in ("mine", "twin")]
    assert chunks[0].headers["chunk-revision"] == "1"
    assert chunks[0].content == chunks[1].content
    assert chunks[0].content != httpx2.get(f"{server.url}/v1/seeds/7/chunks/0/1/0/-1.mesh?recipe=sphere").content


def test_while_a_server_runs_http_is_the_way(server, folder):
    said = refused(1, "world", "list", "--data", folder)
    assert said.startswith(f"{folder} is in use: another server runs on it")
    assert "/v1/worlds" in said
    assert server.child.poll() is None


def seen(descriptor, wanted):
    """Read a terminal until it shows `wanted`; return all that it has shown."""
    shown, deadline = b"", time.monotonic() + SECONDS_MAX
    while wanted not in shown:
        ready = select.select([descriptor], [], [], max(0.0, deadline - time.monotonic()))[0]
        assert ready, shown
        shown += os.read(descriptor, 4096)
    return shown


def test_ctrl_c_ends_it_at_once_and_leaves_nothing(tmp_path):
    terminal, inner = pty.openpty()
    box = ("--recipe", "city", "--box", 0, 0, 0, 31, 0, 1023, "--cells", 64)
    command = [*PROGRAM, "mesh", "city.glb", *map(str, box)]
    child = subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=inner)
    try:
        os.close(inner)
        seen(terminal, b"chunks")
        child.send_signal(signal.SIGINT)
        child.wait(SECONDS_MAX)
    finally:
        child.kill()
        rest = child.communicate()[0]
        os.close(terminal)
    assert (child.returncode, rest) == (130, b"")
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_that_nobody_reads_is_no_failure_to_talk_about():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        child = subprocess.run(
            [*PROGRAM, "recipe", "show", "city"],
            stdout=closed,
            stderr=subprocess.PIPE,
            timeout=SECONDS_MAX,
            check=False,
        )
    assert child.stderr == b""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            "chunkserver ",
            {
                "serve",
                "mesh",
                "inspect",
                "recipe",
                "world",
                "edit",
                "log",
                "verify",
                "migrate",
                "config",
                "key",
                "warm",
            },
        ),
        ("chunkserver world d", {"delete"}),
        ("chunkserver mesh a --recipe pl", {"plane", "planet"}),
        ("chunkserver recipe show floa", {"floating-islands"}),
        ("chunkserver mesh a --format ", {"glb", "mesh", "ply", "obj", "stl"}),
        ("chunkserver mesh a --fr", {"--frame"}),
    ],
)
def test_the_shell_completes_what_is_typed(words, expected):
    typing = {
        "_CHUNKSERVER_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    ended = CliRunner().invoke(app, prog_name="chunkserver", env=typing)
    assert (ended.exit_code, ended.stderr) == (0, "")
    assert set(ended.stdout.split()) == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_can_be_shown(shell, monkeypatch):
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    ended = CliRunner().invoke(app, ["--show-completion", shell], prog_name="chunkserver")
    assert f"_CHUNKSERVER_COMPLETE=complete_{shell}" in ended.stdout
