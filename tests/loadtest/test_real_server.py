"""Each profile against the real server, by the kit's own generator and by Locust."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from chunkserver_loadtest.generator import Limits
from chunkserver_loadtest.profiles import Options
from chunkserver_loadtest.result import Result, Stream
from chunkserver_loadtest.runs import Plan, run
from chunkserver_loadtest.world import world_path
from tests.house.checkout import ROOT, holds
from tests.house.test_layers import own_import
from tests.loadtest.stub import answer, answering, descriptor
from tests.loadtest.test_checks import OTHER
from tests.serving import Server, serving, until

LOCUST_SECONDS_MAX = 90.0
SECONDS = 1.0
EDITS = 50


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("server") / "log", "--workers", "2") as running:
        yield running


def result_of(server: Server, profile: str, file_format: str = "mesh", recipe: str = "terrain", **options) -> Result:
    limits = Limits(seconds=SECONDS, connections=8)
    path = world_path(None, 42, recipe)
    result = run(Plan(server.url, path, profile, Options(**options), limits, file_format), lambda _: None)
    assert result.failures == {}
    assert result.counts.unsent == 0
    assert result.counts.due == result.counts.answered > 0
    return result


@pytest.mark.parametrize("file_format", ["mesh", "glb"])
def test_cold_unique(server, file_format):
    seed = 1 if file_format == "mesh" else 2
    result = result_of(server, "cold-unique", file_format, seed=seed, rate=40, codings=("identity", "zstd", "gzip"))
    assert result.counts.due == 40
    assert result.counts.decoded == result.latency.by_status["200"].count
    assert result.counts.compared == 0


def test_warm_hot(server):
    result = result_of(server, "warm-hot", seed=3, rate=200, hot=8, arrivals="poisson", codings=("identity", "zstd"))
    assert result.counts.due == pytest.approx(200, abs=70)
    assert set(result.latency.by_status) == {"200", "304"}
    assert result.counts.compared == result.latency.by_status["200"].count
    assert result.latency.by_kind["revalidate"].count == result.latency.by_status["304"].count


@pytest.mark.parametrize(("batch", "file_format"), [(0, "mesh"), (64, "mesh"), (64, "glb")])
def test_fly_through(server, batch, file_format):
    result = result_of(
        server,
        "fly-through",
        file_format,
        "hills",
        seed=4,
        viewers=1,
        lods=2,
        speed=100,
        batch=batch,
        codings=("zstd",),
    )
    assert set(result.latency.by_kind) >= ({"batch", "part"} if batch else {"arrive", "fly"})
    asked = result.latency.by_kind["part" if batch else "arrive"].count
    assert asked >= 216 + 189
    assert result.counts.decoded > 10


def test_edit_storm(server):
    found = storm(server, "edit-storm", subscribers=12, silent=0.25, look=64, strokes=2)
    assert 0 < found.told.count < 9 * EDITS, "each looks at a part of the ground"
    assert (found.silent, found.acknowledged, found.connects) == (3, EDITS + 1, 16)


def test_reconnect_storm(server):
    found = storm(server, "reconnect-storm", subscribers=12, missed=5)
    assert found.told.count == 12 * EDITS
    assert (found.welcomed.count, found.back.count, len(found.all_back)) == (15, 12, 1)
    assert found.acknowledged == 1 + EDITS + 5


def storm(server: Server, profile: str, **options: Any) -> Stream:
    """Have a storm in a world of its own, which is gone afterwards. Everything else is a failure of the run."""
    more = Options(seed=7, editors=4, rate=EDITS / SECONDS, **options)
    result = run(Plan(server.url, world_path(None, 42, "terrain"), profile, more, Limits(SECONDS)), lambda _: None)
    assert result.failures == {}
    assert result.counts.due == result.counts.answered == EDITS
    assert httpx2.get(f"{server.url}/v1/worlds").json()["worlds"] == []
    assert result.stream is not None
    assert (result.stream.missed, result.stream.late, result.stream.strange) == (0, 0, 0)
    return result.stream


def locust(url: str, users: tuple[str, ...], kinds: tuple[str, ...], log: Path) -> tuple[int, str]:
    """Run the locustfile until it has told of each of `kinds`; return its exit code, and all that it said."""
    file = ROOT / "clients" / "loadtest" / "locustfile.py"
    options = ("--headless", "--users", str(len(users)), "--host", url, "--load-seed", "6")
    with log.open("wb") as sink:
        command = [sys.executable, "-m", "locust", "--locustfile", str(file), *options, *users]
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink)
    try:
        told = [re.compile(rf"GET +{kind} +[1-9]") for kind in kinds]
        until(lambda: all(one.search(log.read_text()) for one in told), LOCUST_SECONDS_MAX, f"locust tells of {kinds}")
        child.terminate()
        return child.wait(LOCUST_SECONDS_MAX), log.read_text()
    finally:
        child.kill()
        child.wait()


def test_the_locustfile_runs(server, tmp_path):
    users = ("ColdUnique", "WarmHot", "FlyThrough")
    code, said = locust(server.url, users, ("cold", "warm", "arrive"), tmp_path / "log")
    assert code == 0, said
    assert re.search(r"Aggregated +\d+ +0\(0.00%\)", said), said


def test_locust_finds_faults_too(tmp_path):
    with answering(lambda head: answer("200 OK", OTHER) if "/chunks/" in head else descriptor()) as stub:
        code, said = locust(stub.url, ("ColdUnique",), ("cold",), tmp_path / "log")
    assert code == 1
    assert re.search(r"Aggregated +(\d+) +\1\(100.00%\)", said), said
    assert "other-chunk" in said


def test_no_test_of_the_kit_imports_the_server():
    holds(own_import, "tests/loadtest/*.py")
