"""A fork server whose workers do what the request's recipe says, in place of building a chunk. Run as a script."""

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from chunkserver.errors import BadKey
from chunkserver.grid import ChunkKey
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.pipeline import STAGES, Chunk, ChunkRequest, Edited
from chunkserver.recipe import WorldRecipe
from chunkserver.worker import Warmth, main

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, __file__)
BODY_BYTES = 60_000


def ask(deed: str = "answer", argument: str = "", x: int = 0, lod: int = 0) -> ChunkRequest:
    """Return a request that makes a worker of ours do `deed` and answer with `answer(x)`."""
    return ChunkRequest(WorldRecipe(0, json.dumps([deed, argument])), ChunkKey(lod, x, 0, 0))


def answer(x: int) -> Chunk:
    return Chunk("surface", f"{x} ".encode() * (BODY_BYTES // len(f"{x} ")))


def body(size: int) -> bytes:
    """Return what the deed "size" answers with."""
    return random.Random(size).randbytes(size)


def die(marker: str) -> None:
    """Be killed: each time, or only if `marker` names no file yet."""
    if not marker or not Path(marker).exists():
        if marker:
            Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)


def refuse(_: str) -> None:
    raise BadKey("x is out of this world", x=7)


def fail(_: str) -> None:
    raise RuntimeError("a fault of ours")


def wait(marker: str) -> None:
    """Return when `marker` names a file."""
    while not Path(marker).exists():
        time.sleep(0.005)


def hang(marker: str) -> None:
    """Write our pid to `marker`, and never return."""
    if marker:
        Path(marker).write_text(str(os.getpid()))
    while True:
        time.sleep(60)


KEPT: list[bytes] = []


def grow(size: str) -> None:
    """Keep so many bytes more than before."""
    KEPT.append(b"x" * int(size))


DEEDS = {
    "answer": lambda _: None,
    "sleep": lambda seconds: time.sleep(float(seconds)),
    "wait": wait,
    "die": die,
    "refuse": refuse,
    "fail": fail,
    "hang": hang,
    "grow": grow,
}


def bricks(edited: Edited) -> Chunk:
    """Say what lies in the bricks that a chunk's own samples read."""
    slots = edited.deltas.own.slots
    found = edited.arena[slots[slots >= 0]]
    told = {"bricks": len(found), "sum": int(found.sum()), "writeable": edited.arena.flags.writeable}
    return Chunk("surface", json.dumps(told).encode())


def build(request: ChunkRequest, stage: Callable[[str], object], edited: Edited | None = None) -> Chunk:
    deed, argument = json.loads(request.recipe.source)
    if deed == "bricks":
        assert edited is not None
        return bricks(edited)
    if deed == "size":
        return Chunk("surface", body(int(argument)))
    if deed == "stages":
        for name in STAGES:
            stage(name)
            time.sleep(float(argument))
        return answer(request.key.x)
    if deed == "tell":
        return Chunk("surface", json.dumps({"pid": os.getpid(), "modules": sorted(sys.modules)}).encode())
    DEEDS[deed](argument)
    return answer(request.key.x)


if __name__ == "__main__":
    main(build, lambda: Warmth(SOURCES_DIGEST, 0, 0.0))
