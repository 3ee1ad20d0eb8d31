"""The command line: what it prints, its exit codes, and that it asks nobody but this machine."""

import os
import pty
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner, Result

from chunkserver_loadtest import __version__
from chunkserver_loadtest.__main__ import FAILED, MISUSED, app
from chunkserver_loadtest.ceiling import measure
from chunkserver_loadtest.checks import KINDS
from chunkserver_loadtest.compare import METRICS
from chunkserver_loadtest.live import line
from chunkserver_loadtest.result import load, save
from chunkserver_loadtest.runs import NAMES, Snapshot
from tests.loadtest.stream_stub import Message, streaming
from tests.loadtest.stub import answer, answering, descriptor
from tests.loadtest.test_checks import chunk
from tests.loadtest.test_results import result_with

SECONDS_MAX = 60.0
COMMAND = (sys.executable, "-m", "chunkserver_loadtest")


def run(*arguments: str, **environment: str) -> Result:
    return CliRunner().invoke(app, arguments, env=environment)


def world(head: str) -> bytes:
    """Answer like a world in which every chunk has the same surface."""
    return answer("200 OK", chunk(head)) if "/chunks/" in head else descriptor()


def test_a_run_says_what_it_found(tmp_path):
    with answering(world) as server:
        done = run("run", "cold-unique", "--url", server.url, "--seconds", "0.3", "--output", str(tmp_path / "a.json"))
    assert done.exit_code == 0, done.stderr
    assert "30 due, 30 answered, 0 unsent, 0 failed" in done.stdout
    assert "latency (from due)" in done.stdout
    assert "200:30" in done.stderr
    result = load(tmp_path / "a.json")
    assert (result.profile, result.counts.due, result.counts.decoded) == ("cold-unique", 30, 30)
    assert result.options["rate"] == 100.0


def test_the_rate_that_was_intended_is_told_of_a_run_that_ends_early(tmp_path):
    options = ("--rate", "200", "--requests", "20", "--seconds", "30", "--output", str(tmp_path / "a.json"))
    with answering(world) as server:
        assert run("run", "cold-unique", "--url", server.url, *options).exit_code == 0
    result = load(tmp_path / "a.json")
    assert result.counts.due == 20
    assert result.throughput.intended == pytest.approx(200)


def test_a_result_that_cannot_be_written_is_one_line(tmp_path):
    with answering(world) as server:
        done = run(
            "run", "cold-unique", "--url", server.url, "--seconds", "0.1", "--output", str(tmp_path / "no" / "a")
        )
    assert done.exit_code == MISUSED
    assert "10 answered" in done.stdout
    assert "the result cannot be written: " in done.stderr


def test_a_storm_says_what_it_found(tmp_path):
    options = ("--editors", "2", "--subscribers", "4", "--rate", "50", "--seconds", "0.2", "--missed", "2")
    more = ("--world", "w", "--budget", "p99=1000", "--budget", "all_back=5000", "--output", str(tmp_path / "a.json"))
    with streaming() as server:
        done = run("run", "reconnect-storm", "--url", server.url, *options, *more)
    assert done.exit_code == 0, done.stderr
    assert "10 due, 10 answered, 0 unsent, 0 failed" in done.stdout
    assert "2 editors, 4 subscribers" in done.stdout
    assert "0 missed, 0 late, 0 strange; left out by 0 stale, 0 resync" in done.stdout
    assert "welcome again" in done.stdout
    assert "told (from the answer)" in done.stdout
    stream = load(tmp_path / "a.json").stream
    assert stream is not None
    assert stream.acknowledged == server.revision == 1 + 10 + 2


@pytest.mark.parametrize(
    ("profile", "budget", "code", "why"),
    [
        ("edit-storm", "rate=1000000", FAILED, "rate is "),
        ("edit-storm", "last_p99=0", FAILED, "the budget 0.00"),
        ("edit-storm", "rate=1", 0, ""),
        ("edit-storm", "all_back=1", MISUSED, "a result of edit-storm has no all_back"),
        ("edit-storm", "p99=+20%", MISUSED, "the budget of p99 is in percent"),
        ("edit-storm", "speed=1", MISUSED, "'speed=1' is no budget"),
    ],
)
def test_a_budget_of_a_run_is_held(profile, budget, code, why):
    options = ("--editors", "1", "--subscribers", "2", "--rate", "50", "--seconds", "0.1", "--world", "w")
    with streaming() as server:
        done = run("run", profile, "--url", server.url, *options, "--budget", budget)
    assert done.exit_code == code, done.stdout
    assert why in done.stderr


def test_a_storm_that_finds_faults_fails():
    def forgetful(client: str, message: Message) -> list[Message]:
        is_it = message["type"] == "edits" and message["revision"] == "3" and client.endswith("subscriber-1")
        return [{**message, "edits": []} if is_it else message]

    options = ("--editors", "1", "--subscribers", "2", "--rate", "50", "--seconds", "0.1", "--world", "w")
    with streaming(forgetful) as server:
        done = run("run", "edit-storm", "--url", server.url, *options)
    assert done.exit_code == FAILED
    assert "edit-missed 1 x, first /v1/worlds/w/stream: counted once for each subscriber" in done.stdout


def test_a_run_that_finds_faults_fails():
    with answering(lambda head: answer("404 Not Found", b"{}") if "/chunks/" in head else descriptor()) as server:
        done = run("run", "cold-unique", "--url", server.url, "--seconds", "0.2")
    assert done.exit_code == FAILED
    assert "wrong-status 20 x, first /v1/seeds/42/chunks/0/" in done.stdout


def test_a_key_is_sent_and_never_written_down(tmp_path):
    arguments = ("run", "cold-unique", "--seconds", "0.1", "--output", str(tmp_path / "a.json"))
    with answering(world) as server:
        done = run(*arguments, "--url", server.url, CHUNKSERVER_API_KEY="a-secret")
    assert done.exit_code == 0, done.stderr
    assert len(server.requests) == 11
    assert all("Authorization: Bearer a-secret\r\n" in head for head in server.requests)
    assert "a-secret" not in done.stdout + done.stderr + (tmp_path / "a.json").read_text()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("--url", "http://192.0.2.1:8000"), "192.0.2.1 (192.0.2.1) is not this machine: --allow-remote"),
        (("--url", "nonsense"), "'nonsense' is no URL of a server"),
        (("--rate", "0"), "rate is 0.0"),
        (("--seconds", "-1"), "seconds is -1.0"),
        (("--check-share", "2"), "check_share is 2.0"),
        (("--coding", "br"), "coding is br"),
    ],
)
def test_what_cannot_be_is_one_clear_line(arguments, why):
    done = run("run", "cold-unique", *arguments)
    assert done.exit_code == MISUSED
    assert done.stderr.startswith(why)
    assert done.stderr.count("\n") == 1


def test_a_profile_that_there_is_not_is_named():
    done = run("run", "swarm")
    assert (done.exit_code, done.stderr.count("\n")) == (MISUSED, 1)
    there = "cold-unique, warm-hot, fly-through, edit-storm, reconnect-storm"
    assert f"'swarm': there are {there}" in done.stderr


def test_a_format_or_a_world_that_there_is_not_is_named():
    with answering(world) as server:
        done = run("run", "cold-unique", "--url", server.url, "--format", "obj")
    assert (done.exit_code, "has no format 'obj': there are mesh" in done.stderr) == (MISUSED, True)
    with answering(answer("404 Not Found", b'{"title": "no such world"}')) as server:
        done = run("run", "cold-unique", "--url", server.url, "--world", "nowhere")
    assert (done.exit_code, "no such world" in done.stderr) == (MISUSED, True)


@pytest.mark.parametrize(("latency", "code"), [(0.011, 0), (0.013, FAILED)])
def test_compare_fails_when_a_budget_is_broken(tmp_path, latency, code):
    save(result_with(0.01), tmp_path / "a.json")
    save(result_with(latency), tmp_path / "b.json")
    files = (str(tmp_path / "a.json"), str(tmp_path / "b.json"))
    done = run("compare", *files, "--budget", "p99=+20%", "--budget", "errors=0")
    assert done.exit_code == code, done.stdout
    assert ("broken" in done.stdout) is bool(code)
    assert "kept" in done.stdout


def test_compare_refuses_what_it_cannot_read(tmp_path):
    save(result_with(0.01), tmp_path / "a.json")
    done = run("compare", str(tmp_path / "a.json"), str(tmp_path / "b.json"))
    assert (done.exit_code, "b.json is no result" in done.stderr) == (MISUSED, True)
    done = run("compare", str(tmp_path / "a.json"), str(tmp_path / "a.json"), "--budget", "speed=1")
    assert (done.exit_code, "'speed=1' is no budget" in done.stderr) == (MISUSED, True)


def on_a_terminal(arguments: list[str]) -> tuple[int, str]:
    """Run a command on a terminal of its own, and return its exit code and all that was drawn."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen(arguments, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as child:
        os.close(theirs)
        drawn, ending = b"", threading.Timer(SECONDS_MAX, child.kill)
        ending.start()
        try:
            while piece := os.read(ours, 1 << 16):
                drawn += piece
        except OSError:  # Linux says so when the other end is closed
            pass
        finally:
            ending.cancel()
        os.close(ours)
        return child.wait(SECONDS_MAX), drawn.decode()


def test_a_terminal_shows_the_run_while_it_goes_on():
    with answering(world) as server:
        code, drawn = on_a_terminal([*COMMAND, "run", "cold-unique", "--url", server.url, "--seconds", "1.5"])
    assert code == 0, drawn
    assert drawn.count("in flight") >= 2
    assert "sent late by" in drawn
    assert "150 due, 150 answered" in drawn


def test_a_line_says_what_failed():
    snapshot = Snapshot(1.0, 2.0, 50.0, 1.0, 3, 60, 50, 2, 4, 1.0, 2.0, 3.0, 0.1, {"200": 46, "503": 4}, {})
    assert "200:46 503:4" in line(snapshot)
    assert line(snapshot).endswith("2 unsent  4 FAILED")


def test_the_ceiling_is_measured():
    found = measure(seconds=0.3, connections=4, body_bytes=1000)
    assert found.requests_per_second > 500
    assert 0 < found.cpu_us < 2000
    assert found.rate == pytest.approx(found.requests_per_second / 2)
    assert 0 < found.lag_p50 <= found.lag_p99
    assert found.lag_p50 <= found.latency_p50 <= found.latency_p99


def test_the_ceiling_is_said():
    done = run("ceiling", "--seconds", "0.2", "--body-bytes", "100")
    assert done.exit_code == 0, done.stderr
    assert "requests/s" in done.stdout
    assert "us of CPU each" in done.stdout


def test_the_version_is_said():
    done = subprocess.run([*COMMAND, "--version"], capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert (done.returncode, done.stdout) == (0, f"chunkserver-loadtest {__version__}\n")


def test_the_page_names_every_option_and_kind():
    page = (Path(__file__).parents[2] / "docs" / "load-testing.md").read_text()
    command: Any = get_command(app)
    options = {option for parameter in command.commands["run"].params for option in parameter.opts if option[0] == "-"}
    assert len(options) > 20
    assert not {option for option in options if f"`{option}`" not in page}
    assert all(f"| `{kind}` | {meaning} |" in page for kind, meaning in KINDS.items())
    assert not {metric for metric in METRICS if f"`{metric}`" not in page}
    assert not {name for name in NAMES if f"| `{name}` | " not in page}
