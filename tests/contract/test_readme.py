"""What README.md and docs/api.md tell people to type, typed against the real server."""

import json
import re
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import FORMATS
from tests.worlds import chunk_mesh

ROOT = Path(__file__).parents[2]
README, API = ((ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/api.md"))
WRITTEN = "http://127.0.0.1:8000"
URLS = re.findall(rf"^curl .*?({WRITTEN}[^'\s]*)", README + API, re.MULTILINE)
POSTS = re.findall(rf"^curl .*-d '([^']+)' ({WRITTEN}\S*)", README + API, re.MULTILINE)
BATCHES = [url for _, url in POSTS if url.endswith("/chunks")]
(PYTHON,) = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def server(server):
    for body, url in POSTS:
        httpx2.post(url.replace(WRITTEN, server.url), json=json.loads(body)).raise_for_status()
    return server


def test_what_is_posted_is_what_is_asked_for(server):
    assert len(POSTS) == (README + API).count(" -d ") >= 1
    for body, url in POSTS:
        answer = httpx2.post(url.replace(WRITTEN, server.url), json=json.loads(body))
        if url in BATCHES:
            assert answer.content.startswith(b"CHNB")
            continue
        made = answer.json()
        if url.endswith("/edits"):
            assert made["stale"]
            continue
        named = f"?recipe={made['digest']}" if "digest" in made else f"/worlds/{made['id']}/"
        assert any(named in url for url in URLS), f"the pages should name {named}"


def test_no_url_is_overlooked():
    assert len(URLS) == (README + API).count("curl ") >= 5


@pytest.mark.parametrize("url", [url for url in URLS if url not in BATCHES])
def test_every_url(server, url):
    answer = httpx2.get(url.replace(WRITTEN, server.url))
    assert answer.status_code == 200
    extension = url.partition("?")[0].rpartition("/")[2].partition(".")[2]
    media_types = {row.name: row.media_type for row in FORMATS.values()} | {"": "application/json"}
    assert answer.headers["content-type"] == media_types[extension]


def test_the_first_steps_in_python(server):
    assert PYTHON.count(WRITTEN) == 1
    code = PYTHON.replace(WRITTEN, server.url)
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True).stdout
    mesh = chunk_mesh(WorldRecipe(42, builtin("planet")), ChunkKey(0, 4, 3, 0))
    vertices, triangles, *corners = map(float, re.findall(r"-?\d+(?:\.\d+)?", said))
    assert (vertices, triangles) == (len(mesh.positions), len(mesh.triangles))
    assert len(corners) == 6
    for low, high, begin in zip(corners[:3], corners[3:], (128, 96, 0), strict=True):
        assert begin <= low < high <= begin + 32
