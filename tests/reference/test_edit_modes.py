"""Edits without the compiler, with every index checked, and compiled for another processor: the same bits."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reference.edit_modes import edits_digest

ROOT = Path(__file__).parents[2]
CACHE = ROOT / ".cache"
SECONDS_MAX = 300


@pytest.mark.parametrize(
    ("mode", "compiled", "checked"),
    [
        ({"NUMBA_DISABLE_JIT": "1"}, False, True),
        ({"NUMBA_BOUNDSCHECK": "1"}, True, True),
        ({"NUMBA_CPU_NAME": "generic"}, True, False),
    ],
    ids=["plain Python", "bounds checked", "another processor"],
)
def test_same_bricks(mode, compiled, checked):
    # Folders of compiled code of their own: Numba takes code without checks from the folder of code with checks.
    folder = "bounds-checked" if "NUMBA_BOUNDSCHECK" in mode else "generic"
    environment = os.environ | {"CHUNKSERVER_CACHE_DIR": str(CACHE / folder)} | mode
    command = [sys.executable, "-m", "tests.reference.edit_modes"]
    found = subprocess.run(command, env=environment, cwd=ROOT, check=True, stdout=subprocess.PIPE, timeout=SECONDS_MAX)
    report: dict[str, object] = json.loads(found.stdout)
    assert report == {"compiled": compiled, "bounds_checked": checked, "digest": edits_digest()}
