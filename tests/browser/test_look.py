"""How worlds look, as far as it can be told without a graphics card."""

import subprocess
from pathlib import Path
from typing import Final

VIEWER: Final = Path(__file__).parents[2] / "clients/viewer"
SECONDS_MAX: Final = 120.0


def test_light_and_ground_are_where_they_should_be():
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
