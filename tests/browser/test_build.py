"""What is shipped is what the sources build, byte by byte, and small enough."""

import gzip
import subprocess
from pathlib import Path
from typing import Final

from chunkserver.server.viewer import FOLDER, GZIP_LEVEL

VIEWER: Final = Path(__file__).parents[2] / "clients/viewer"
SECONDS_MAX: Final = 120.0
BYTES_MAX: Final = 400_000
"""Of the page and all that it needs before it talks to the server, compressed."""


def run(*command: str) -> None:
    ran = subprocess.run(
        command, cwd=VIEWER, text=True, timeout=SECONDS_MAX, capture_output=True, check=False, stdin=subprocess.DEVNULL
    )
    assert ran.returncode == 0, f"\n{ran.stdout}\n{ran.stderr}"


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_shipped_is_what_is_built(tmp_path: Path):
    run("npm", "run", "--silent", "lint")
    run("npm", "run", "--silent", "build", "--", "--outDir", str(tmp_path))
    built, shipped = files(tmp_path), files(FOLDER)
    assert sorted(shipped) == sorted(built), "`make viewer` builds it anew"
    assert [name for name in built if built[name] != shipped[name]] == []


def test_it_is_small():
    assert sum(len(gzip.compress(content, GZIP_LEVEL)) for content in files(FOLDER).values()) < BYTES_MAX
