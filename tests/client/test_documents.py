"""The README's code and the examples, run as a newcomer would, against a real server."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2] / "clients/python"
README = (ROOT / "README.md").read_text(encoding="utf-8")
WRITTEN = "http://127.0.0.1:8000"
BLOCKS = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
SECONDS_MAX = 120
ENVIRONMENT = {**os.environ, "MPLBACKEND": "agg", "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}


def said(*command: str) -> str:
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=SECONDS_MAX, check=True, env=ENVIRONMENT
    ).stdout


SAYS = (
    r"surface \(\d+, 3\) \(\d+, 3\)\nChunkKey\(lod=0, x=(0|-1), y=6, z=0\) \d+\n(ChunkKey\(.*\) \d+\n){15}",
    r"\[\d+(, \d+){7}\]\n(ChunkKey\(lod=1, .*\) (air|rock|surface)\n){4}",
    r"bowl [0-9a-f]{32} \['bowl'\]\nworld-exists .* \{'id': 'bowl'\}\n422 radius\n",
    r"\d+ fetched, \d\d+ to draw\n" * 3,
    r"(\d+ of 24 chunks are drawn anew\n)+1 1\n\[\(1, 3\)\]\n",
    r"(dug by somebody else: sphere\n)?acknowledged as 1\n4 chunks, of revisions \[(0, )?1\]\n",
    r"\[1125899\d{9}\s+-?\d+\s+\d+\] \[[- .\de]+\]\n",
)


@pytest.mark.parametrize("number", range(len(SAYS)))
def test_the_readmes_code(server, number):
    assert len(BLOCKS) == len(SAYS)
    assert BLOCKS[number].count(WRITTEN) == 1
    found = said("-W", "error", "-c", BLOCKS[number].replace(WRITTEN, server.url))
    assert re.fullmatch(SAYS[number], found), found


def test_the_readme_names_every_call_and_error():
    for name in re.findall(r"^    def ([a-z]\w+)", (ROOT / "chunkserver_client/client.py").read_text(), re.MULTILINE):
        assert f"`{name}`" in README or name == "close"
    for name in re.findall(r"^class (\w+)\(", (ROOT / "chunkserver_client/errors.py").read_text(), re.MULTILINE):
        assert f"`{name}`" in README


def test_the_example_of_two_players(server):
    found = said("-W", "error", str(ROOT / "examples/two_players.py"), "--url", server.url, "--seconds", "0.01")
    player = r"(ann|bob): 20 edits of others, \d+ chunks fetched, known up to revision 40\n"
    assert re.fullmatch(f"({player}){{2}}40 edits in the log\n", found), found


@pytest.mark.parametrize(
    ("script", "options", "says"),
    [
        ("plot_chunk.py", (), "5,170 triangles"),
        ("weld_chunks.py", ("--radius", "64", "--pixels", "250"), "watertight: True"),
    ],
)
def test_an_example(server, tmp_path, script, options, says):
    output = tmp_path / "picture.png"
    found = said(str(ROOT / "examples" / script), "--url", server.url, "--output", str(output), *options)
    assert says in found
    with Image.open(output) as picture:
        colours = picture.convert("RGB").getcolors(1 << 24)
        assert colours is not None
        assert len(colours) > 200, "something is drawn"
