"""The web client's own tests, run by Node.js against a real server: `npm test` in clients/web."""

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Final

import numpy as np

from tests.scale import count
from tests.serving import serving
from tests.web.journeys import journeys

CLIENT: Final = Path(__file__).parents[2] / "clients/web"
SECONDS_MAX: Final = 240.0
TESTS_MIN: Final = 50
"""Fewer were found if some file was not compiled, or not run."""


def test_the_web_client(tmp_path: Path, rng: np.random.Generator):
    ways = tmp_path / "journeys.json"
    ways.write_text(json.dumps(journeys(rng, max(count(10_000), 100))))
    with serving(tmp_path / "log", "--workers", "1") as server:
        surroundings = {"CHUNKSERVER_URL": server.url, "CHUNKSERVER_JOURNEYS": str(ways)}
        ran = subprocess.run(
            ["npm", "test"],
            cwd=CLIENT,
            env={**os.environ, **surroundings},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=SECONDS_MAX,
            check=False,
        )
    assert ran.returncode == 0, f"\n{ran.stdout}"
    told = {
        name: int(number)
        for name, number in re.findall(r"^\S+ (tests|fail|skipped|todo) (\d+)$", ran.stdout, re.MULTILINE)
    }
    assert told["tests"] >= TESTS_MIN, f"\n{ran.stdout}"
    assert told["fail"] == told["skipped"] == told["todo"] == 0, f"\n{ran.stdout}"
