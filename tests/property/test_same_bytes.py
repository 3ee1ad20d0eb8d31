"""The same request gives the same bytes: from one worker and from two, with a cold and a warm cache of compiled code,
and from code that was compiled for another processor."""

import asyncio
import hashlib
import logging
import sys
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from chunkserver.grid import ChunkKey
from chunkserver.kernel import CACHE_DIR
from chunkserver.mesher import MESHERS
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.server.pool import Pool
from chunkserver.wire import Encoding
from chunkserver.worker import warm

KEYS = (
    ChunkKey(0, 0, 0, 0),
    ChunkKey(0, 1, -1, 0),
    ChunkKey(0, -2, 0, 1),
    ChunkKey(0, 2, -2, -2),
    ChunkKey(2, -1, 0, 0),
    ChunkKey(5, 0, -1, -1),
)
ENCODINGS = (Encoding("mesh", "std"), Encoding("mesh", "f32"), Encoding("glb"))
WARM_SECONDS_MAX = 300.0

BORDERS = ((0, "transitions"), (37, "transitions"), (0, "skirts"))

REQUESTS = [
    ChunkRequest(WorldRecipe(seed, builtin(name)), key, mesher=mesher, coarser=mask, seam=seam, encoding=encoding)
    for name in BUILTINS
    for mesher in MESHERS
    for seed, key in enumerate(KEYS, start=-2)
    for encoding, (mask, seam) in zip(ENCODINGS, BORDERS, strict=True)
]


def digest(body: bytes) -> str:
    return hashlib.blake2b(body, digest_size=16).hexdigest()


@pytest.fixture(scope="module")
def digests() -> list[str]:
    """What this process, without any worker, makes of the requests."""
    warm()
    chunks = [build_chunk(request) for request in REQUESTS]
    surfaces = sum(chunk.content == "surface" for chunk in chunks)
    assert surfaces >= len(REQUESTS) // 3, "most of a sample of empty chunks would be alike by nature"
    return [digest(chunk.body) for chunk in chunks]


def fork_server(cache: Path, **environment: str) -> Sequence[str]:
    """Return the command of a fork server that keeps its compiled code in `cache`."""
    variables = {"CHUNKSERVER_CACHE_DIR": str(cache), **environment}
    return [
        "env",
        *(f"{name}={value}" for name, value in variables.items()),
        sys.executable,
        "-m",
        "chunkserver.worker",
    ]


async def built(*pools: Pool) -> list[list[str]]:
    """Start all pools at once; return the digests that each makes of the requests."""
    async with AsyncExitStack() as stack:
        for pool in pools:
            await pool.start()
            stack.push_async_callback(pool.close)
        async with asyncio.timeout(WARM_SECONDS_MAX):
            await asyncio.gather(*(pool.wait_ready() for pool in pools))
        found = []
        for pool in pools:
            chunks = [
                await asyncio.gather(*map(pool.build, REQUESTS[at : at + 100])) for at in range(0, len(REQUESTS), 100)
            ]
            found.append([digest(chunk.body) for part in chunks for chunk in part])
        return found


def test_two_workers_and_a_warm_cache(digests):
    assert asyncio.run(built(Pool(2))) == [digests]


def test_two_cold_starts_at_once_and_another_processor(digests, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    here, generic = fork_server(tmp_path / "here"), fork_server(tmp_path / "generic", NUMBA_CPU_NAME="generic")
    found = asyncio.run(built(Pool(1, command=here), Pool(2, command=here), Pool(1, command=generic)))
    assert found == [digests, digests, digests]

    functions = sorted(record.args[1] for record in caplog.records if record.msg.startswith("warm after"))
    assert functions[0] == 0, "who waits for the lock loads what the other has compiled"
    assert functions[1] == functions[2] > 0
    for folder in ("here", "generic"):
        files = list((tmp_path / folder / CACHE_DIR.name).rglob("*.nbi"))
        assert len(files) == functions[1], "warming has compiled all that a worker runs; a worker compiles nothing"
