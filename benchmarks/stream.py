"""The stream of edits: the real server with one worker, which syncs each edit to the real disk before it answers.

Each edit is one ball of radius 6, on 512 x 512 voxels of `terrain`. All peers are in one process, which shares cores
with the server.

- Told: 10 editors send 100 edits a second to 100 listeners, who look everywhere. The time is from acknowledgement of
  an edit, or from its sending, until the last of the listeners has it.
- Editors: each of 32 sends its next edit when the one before is acknowledged. Nobody listens.
- Back: 500 listeners are cut, miss 100 edits, and come back at the same moment. Until all of them are caught up.
"""

import asyncio
import random
import tempfile
import time
from collections.abc import Callable, Coroutine, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import httpx2

from benchmarks.load import LOAD_SECONDS_MAX
from benchmarks.measure import MS, Figure, Line, Scale, in_turns
from benchmarks.service import cpu_seconds
from chunkserver_loadtest.crowd import Crowd
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.target import resolve
from chunkserver_loadtest.tellings import Sent
from tests.serving import Server, serving

PATH: Final = "/v1/worlds/stream"
WORLD: Final = {"id": "stream", "seed": "42", "recipe": "terrain"}
SIDE: Final = 512.0
LISTENERS: Final = 100
EDITORS: Final = 10
EDITS_PER_SECOND: Final = 100
CLOSED_EDITORS: Final = 32
BACK: Final = 500
MISSED: Final = 100
"""Edits."""
ROUNDS_MAX: Final = 3
SETTLE_SECONDS_MAX: Final = 60.0

Figures = dict[tuple[str, str], float]


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for those who are told, for editors, and for those who come back."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "log", "--workers", "1") as server:
        httpx2.post(f"{server.url}/v1/worlds", json=WORLD, timeout=LOAD_SECONDS_MAX).raise_for_status()
        seconds = scale.load_seconds
        _in_loop(server, lambda crowd: _told(server, crowd, 0.3))  # a first edit waits for compiled code to be loaded
        candidates: dict[str, Callable[[], Figures]] = {
            f"{EDITS_PER_SECOND} edits a second, {LISTENERS} listeners": lambda: _in_loop(
                server, lambda crowd: _told(server, crowd, seconds)
            ),
            f"{CLOSED_EDITORS} editors": lambda: _in_loop(server, lambda crowd: _acknowledged(crowd, seconds)),
            f"{BACK} come back": lambda: _in_loop(server, _back),
        }
        for subject, turns in in_turns(candidates, min(scale.starts, ROUNDS_MAX), uncounted=0).items():
            yield Line(subject, tuple(Figure(*name, tuple(turn[name] for turn in turns)) for name in turns[0]))


def _in_loop(server: Server, turn: Callable[[Crowd], Coroutine[Any, Any, Figures]]) -> Figures:
    async def limited() -> Figures:
        crowd = Crowd(resolve(server.url), PATH)
        try:
            async with asyncio.timeout(LOAD_SECONDS_MAX):
                found = await turn(crowd)
        finally:
            crowd.close()
        if crowd.refused:
            raise RuntimeError(f"{crowd.refused} edits were refused")
        if crowd.lost or crowd.unsettled:
            raise RuntimeError(f"{len(crowd.lost)} peers were lost, {crowd.unsettled} edits are not told: {crowd.lost}")
        return found

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        return runner.run(limited())


def _carve(chance: random.Random) -> list[dict[str, Any]]:
    x, y, z = (chance.uniform(-side / 2, side / 2) for side in (SIDE, SIDE / 32, SIDE))
    return [{"op": "carve", "shape": "sphere", "center": [x, y, z], "radius": 6.0}]


async def _told(server: Server, crowd: Crowd, seconds: float) -> Figures:
    await crowd.join([f"editor-{number}" for number in range(EDITORS)], edit=True)
    await crowd.join([f"listener-{number}" for number in range(LISTENERS)])
    sent: list[Sent] = []
    cpu, begun, chance = cpu_seconds(server.child.pid), time.perf_counter(), random.Random()
    for number in range(max(1, int(seconds * EDITS_PER_SECOND))):
        due = begun + number / EDITS_PER_SECOND
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        sent.append(crowd.edit(f"editor-{number % EDITORS}", _carve(chance), due))
    await crowd.settle(SETTLE_SECONDS_MAX)
    spent = cpu_seconds(server.child.pid) - cpu
    waits = {
        "from ack": [edit.told_at - edit.answered for edit in sent],
        "from sending": [edit.told_at - edit.due for edit in sent],
    }
    figures = {
        (f"{name}, {label}", "ms"): _quantile(times, share) * MS
        for name, times in waits.items()
        for label, share in (("median", 0.5), ("99 %", 0.99))
    }
    return figures | {("server CPU", "%"): spent / (time.perf_counter() - begun) * 100}


async def _acknowledged(crowd: Crowd, seconds: float) -> Figures:
    names, times = [f"editor-{number}" for number in range(CLOSED_EDITORS)], list[float]()
    await crowd.join(names, edit=True)
    begun, chance = time.perf_counter(), random.Random()
    end = begun + seconds

    async def edit_on(name: str) -> None:
        while time.perf_counter() < end:
            sent = await crowd.edited(name, _carve(chance))
            times.append(sent.answered - sent.sent)

    await asyncio.gather(*map(edit_on, names))
    return {
        ("acknowledged", "1/s"): len(times) / (time.perf_counter() - begun),
        ("median", "ms"): _quantile(times, 0.5) * MS,
        ("99 %", "ms"): _quantile(times, 0.99) * MS,
    }


async def _back(crowd: Crowd) -> Figures:
    await crowd.join([f"listener-{number}" for number in range(BACK)])
    await crowd.join(["editor"], edit=True)
    chance = random.Random()

    async def away() -> None:
        for _ in range(MISSED):
            await crowd.edited("editor", _carve(chance))

    found = [back.caught_up for back in await crowd.come_back(away)]
    await crowd.settle(SETTLE_SECONDS_MAX)
    return {("median", "s"): _quantile(found, 0.5), ("all caught up", "s"): max(found)}


def _quantile(values: Sequence[float], share: float) -> float:
    return sorted(values)[min(int(share * len(values)), len(values) - 1)]
