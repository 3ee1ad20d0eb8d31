"""The mesher without the compiler and with every index checked: the same bytes, and no index outside its array."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reference.modes import bounds_are_checked, meshes_digest

ROOT = Path(__file__).parents[2]
CACHE = ROOT / ".cache"
SECONDS_MAX = 300


def report(mode: dict[str, str]) -> dict[str, object]:
    # A folder of compiled code of its own: Numba takes code without checks from the folder of code with checks.
    environment = os.environ | {"CHUNKSERVER_CACHE_DIR": str(CACHE / "bounds-checked")} | mode
    command = [sys.executable, "-m", "tests.reference.modes"]
    found = subprocess.run(command, env=environment, cwd=ROOT, check=True, stdout=subprocess.PIPE, timeout=SECONDS_MAX)
    answer: dict[str, object] = json.loads(found.stdout)
    return answer


def test_compiled_code_does_not_check_bounds():
    assert not bounds_are_checked()


@pytest.mark.parametrize(
    ("mode", "compiled"),
    [({"NUMBA_DISABLE_JIT": "1"}, False), ({"NUMBA_BOUNDSCHECK": "1"}, True)],
    ids=["plain Python", "bounds checked"],
)
def test_same_meshes(mode, compiled):
    assert report(mode) == {
        "compiled": compiled,
        "bounds_checked": True,
        "digest": meshes_digest(),
    }
