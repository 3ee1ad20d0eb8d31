"""The same bits without the compiler, with bounds checked, and compiled for another CPU."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from chunkserver.field import sample
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin

KEYS = [(0, 0, -1, 0), (0, -1, 0, 2), (3, -5, 0, 7), (0, 2**35, -1, -(2**35))]
SHAPE = ChunkShape(16)
SECONDS_MAX = 300


def digests(keys: int, names: list[str]) -> dict[str, str]:
    """Return the digest of each named recipe's samples at the first `keys` of KEYS."""
    found = {}
    for name in names:
        recipe = WorldRecipe(7, builtin(name))
        with np.errstate(over="ignore"):  # without the compiler, integers warn where they wrap
            chunks = [sample(recipe, ChunkKey(*key), SHAPE).density.tobytes() for key in KEYS[:keys]]
        found[name] = hashlib.blake2b(b"".join(chunks), digest_size=16).hexdigest()
    return found


@pytest.mark.parametrize(
    ("keys", "names", "environment"),
    [
        (1, ["terrain", "sphere"], {"NUMBA_DISABLE_JIT": "1"}),
        (4, list(BUILTINS), {"NUMBA_BOUNDSCHECK": "1"}),
        (4, list(BUILTINS), {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}),
    ],
    ids=["plain Python", "bounds checked", "generic CPU"],
)
def test_the_bits_are_the_same(keys, names, environment, tmp_path):
    answer = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.property.test_field_modes", str(keys), *names],
        env={**os.environ, **environment, "CHUNKSERVER_CACHE_DIR": str(tmp_path)},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert json.loads(answer.stdout) == digests(keys, names)


if __name__ == "__main__":
    print(json.dumps(digests(int(sys.argv[1]), sys.argv[2:])))  # noqa: T201 - read by the test above
