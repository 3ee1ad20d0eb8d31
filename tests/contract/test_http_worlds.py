"""Worlds that are kept, asked of the real server: over restarts, after kill -9, with a folder that cannot be had."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import apsw
import httpx2
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.store.schema import FORMAT
from chunkserver.store.sqlite import FILE_NAME, LOCK_NAME
from chunkserver.wire import Encoding
from tests.fault.pools import children
from tests.serving import SERVE, serving

SECONDS_MAX = 60.0
TREE = {"op": "sphere", "radius": 20}
NEW = [
    {"id": "a", "seed": "-7", "recipe": TREE, "voxel_size": 0.1, "lods": 3, "chunk_cells": 64},
    {"id": "b", "seed": 2**63 - 1, "recipe": "terrain"},
]


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "worlds"


def kept(log, folder, **options):
    return serving(log, "--workers", "1", "--data", str(folder), **options)


def create(server, new):
    answer = httpx2.post(f"{server.url}/v1/worlds", json=new, timeout=SECONDS_MAX)
    assert answer.status_code == 201
    return answer.json()


def told(server):
    """All that a server says of its worlds."""
    names = [world["id"] for world in httpx2.get(f"{server.url}/v1/worlds").json()["worlds"]]
    chunks = [httpx2.head(f"{server.url}/v1/worlds/{name}/chunks/0/0/0/0.glb").headers["etag"] for name in names]
    return [httpx2.get(f"{server.url}/v1/worlds/{name}").json() for name in names], chunks


def ends_at_once(folder):
    """What a server says that does not start."""
    command = [sys.executable, *SERVE, "--data", str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    return ended.stderr


def open_files(pid):
    found = set()
    for path in Path(f"/proc/{pid}/fd").iterdir():
        try:
            found.add(path.readlink().name)
        except FileNotFoundError:
            continue
    return found


def test_a_restart_keeps_worlds_epochs_and_tags(tmp_path, folder):
    with kept(tmp_path / "log1", folder) as server:
        created = [create(server, new) for new in NEW]
        before = told(server)
        assert before[0] == created
        chunk = httpx2.get(f"{server.url}/v1/worlds/a/chunks/1/0/-1/0.glb")
        recipe = WorldRecipe(-7, canonical(TREE))
        key = ChunkKey(1, 0, -1, 0)
        expected = build_chunk(ChunkRequest(recipe, key, cells=64, voxel_size=0.1, encoding=Encoding("glb")))
        assert (chunk.content, chunk.headers["chunk-content"]) == (expected.body, "surface")
    with kept(tmp_path / "log2", folder) as server:
        assert told(server) == before
        httpx2.delete(f"{server.url}/v1/worlds/b").raise_for_status()
        again = create(server, NEW[1])
        assert {name for name in again if again[name] != created[1][name]} >= {"epoch", "urls"}
        worlds, tags = told(server)
        assert (worlds[0], tags[0]) == (before[0][0], before[1][0])
        assert tags[1] != before[1][1]


def test_a_second_server_is_refused_and_told_why(tmp_path, folder):
    with kept(tmp_path / "log", folder) as server:
        said = ends_at_once(folder)
        assert str(folder) in said
        assert "in use" in said
        assert create(server, NEW[1])["durable"] is True


def test_a_start_right_after_kill_9_finds_everything(tmp_path, folder):
    with pytest.raises(AssertionError, match="exit code -9"):
        kill_and_start(tmp_path, folder)


def kill_and_start(tmp_path, folder):
    """The first server's fork server and worker are held, so that they live on for sure while the second one starts."""
    with kept(tmp_path / "log1", folder) as first:
        (fork_server,) = children(first.child.pid)
        left = [fork_server, *children(fork_server)]
        assert len(left) == 2
        assert {FILE_NAME, LOCK_NAME} <= open_files(first.child.pid)
        for pid in left:
            os.kill(pid, signal.SIGSTOP)
            assert not any(name.startswith((FILE_NAME, LOCK_NAME)) for name in open_files(pid))
        created = httpx2.post(f"{first.url}/v1/worlds", json=NEW[1]).json()
        assert first.stop(signal.SIGKILL) == -signal.SIGKILL
        with kept(tmp_path / "log2", folder, ready=False) as second:
            assert httpx2.get(f"{second.url}/v1/worlds/b").json() == created
            assert all(Path(f"/proc/{pid}").exists() for pid in left)


def test_a_file_that_cannot_be_read_is_refused(tmp_path, folder):
    with kept(tmp_path / "log", folder, ready=False):
        pass
    file = folder / FILE_NAME
    whole = file.read_bytes()
    connection = apsw.Connection(str(file))
    connection.pragma("user_version", FORMAT + 1)
    connection.close()
    assert f"format {FORMAT + 1}" in ends_at_once(folder)
    for damaged, word in ((whole[: len(whole) // 2], "malformed"), (b"x" * 9000, "not a database")):
        file.write_bytes(damaged)
        said = ends_at_once(folder)
        assert word in said
        assert str(file) in said
    file.write_bytes(whole)
    with kept(tmp_path / "log2", folder, ready=False) as server:
        assert httpx2.get(f"{server.url}/v1/worlds").json()["count"] == 0


def test_head_has_the_headers_of_get_and_no_body(tmp_path):
    with serving(tmp_path / "log", "--workers", "1") as server, httpx2.Client(base_url=server.url) as client:
        client.post("/v1/worlds", json=NEW[1]).raise_for_status()
        chunk = "/v1/worlds/b/chunks/0/0/0/0"
        assert (
            client.get(chunk).content
            == build_chunk(ChunkRequest(WorldRecipe(2**63 - 1, builtin("terrain")), ChunkKey(0, 0, 0, 0))).body
        )
        for url in ("/v1/worlds", "/v1/worlds/b", "/v1/worlds/x", chunk, f"{chunk}.glb", "/v1/worlds/b/chunks/0/0/9/0"):
            got, head = (ask(url, headers={"X-Request-Id": "mine"}) for ask in (client.get, client.head))
            for answer in (got, head):
                del answer.headers["date"]
                answer.headers.pop("x-request-id", None)  # what is answered out of memory has none
            assert (head.status_code, head.content, head.headers) == (got.status_code, b"", got.headers), url
        for url, methods in (("/v1/worlds", {"GET", "HEAD", "POST"}), ("/v1/worlds/b", {"GET", "HEAD", "DELETE"})):
            answer = client.put(url)
            assert (answer.status_code, set(answer.headers["allow"].split(", "))) == (405, methods)
