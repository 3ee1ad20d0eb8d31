"""The web client's own tests, run by Node.js against a real server: `npm test` in clients/web."""

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Final

import numpy as np

from chunkserver.server.keys import mint
from tests.scale import count
from tests.serving import serving
from tests.web.histories import histories
from tests.web.journeys import journeys

CLIENT: Final = Path(__file__).parents[2] / "clients/web"
SECONDS_MAX: Final = 240.0
TESTS_MIN: Final = 110
"""Fewer were found if some file was not compiled, or not run."""


def test_the_web_client(tmp_path: Path, rng: np.random.Generator):
    key, kept = mint("player", "admin")
    surroundings = {"CHUNKSERVER_KEY": key}
    for name, lives in (("journeys", journeys), ("histories", histories)):
        file = tmp_path / f"{name}.json"
        file.write_text(json.dumps(lives(rng, count(10_000))))
        surroundings[f"CHUNKSERVER_{name.upper()}"] = str(file)
    with (
        serving(tmp_path / "log", "--workers", "1") as server,
        serving(tmp_path / "keyed", "--workers", "1", "--api-keys", str(kept)) as keyed,
    ):
        surroundings |= {"CHUNKSERVER_URL": server.url, "CHUNKSERVER_KEYED_URL": keyed.url}
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
