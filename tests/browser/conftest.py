"""A Chromium and a server for all tests of the page."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from tests.serving import Server, serving

DRIVER: Final = Path(__file__).with_name("drive.mjs")
STOP_SECONDS_MAX: Final = 30.0

Play = Callable[..., dict[str, Any]]


@pytest.fixture(scope="package")
def server(tmp_path_factory) -> Iterator[Server]:
    """For scenes that do not mind what others have dug."""
    with serving(tmp_path_factory.mktemp("server") / "log", "--workers", "1") as running:
        yield running


@pytest.fixture(scope="package")
def play(tmp_path_factory) -> Iterator[Play]:
    """Plays a scene of `scenes/` and returns what it has found.

    keeps: its pages stay open, for the next scene that continues. All else is in drive.mjs.
    """
    folder = tmp_path_factory.mktemp("chromium")
    driver = subprocess.Popen(
        ["node", DRIVER],
        cwd=DRIVER.parents[1],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder)},
    )
    assert driver.stdin is not None
    assert driver.stdout is not None
    stdin, stdout = driver.stdin, driver.stdout

    def played(scene: str, server: Server, **given: Any) -> dict[str, Any]:
        stdin.write(json.dumps({"scene": scene, "url": server.url, **given}) + "\n")
        stdin.flush()
        answer = json.loads(stdout.readline())
        assert "found" in answer, answer["error"]
        found: dict[str, Any] = answer["found"]
        return found

    try:
        yield played
        stdin.close()
        stdout.read()
        stdout.close()
        assert driver.wait(STOP_SECONDS_MAX) == 0
    finally:
        driver.kill()
        driver.wait()
