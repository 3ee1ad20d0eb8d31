"""The viewer's own tests, run by Node.js: `npm test` in clients/viewer. What they test needs no browser."""

import re
import subprocess
from pathlib import Path
from typing import Final

VIEWER: Final = Path(__file__).parents[2] / "clients/viewer"
SECONDS_MAX: Final = 120.0
TESTS_MIN: Final = 70
"""Fewer were found if some file is not imported."""


def test_the_viewer():
    ran = subprocess.run(
        ("npm", "test"),
        cwd=VIEWER,
        text=True,
        timeout=SECONDS_MAX,
        capture_output=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert ran.returncode == 0, f"\n{ran.stdout}\n{ran.stderr}"
    told = dict(re.findall(r"^\S+ (tests|fail|skipped|todo) (\d+)$", ran.stdout, re.MULTILINE))
    assert int(told["tests"]) >= TESTS_MIN, f"\n{ran.stdout}"
    assert told["fail"] == told["skipped"] == told["todo"] == "0", f"\n{ran.stdout}"
