"""Clients that edit overlapping places of one world and ask for its chunks, and note all they do.

Each sends again, and asks again, until it is answered: a server may be killed, and another one come in its place.
"""

import asyncio
import hashlib
import random
import time
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import httpx2

from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, builtin
from tests.fault.linear import Logged, Range, Record, Seen, Sent, reaches

CELLS, LODS = 16, 3
RECIPE = WorldRecipe(7, builtin("terrain"))
WORLD = {"id": "w", "seed": "7", "recipe": "terrain", "chunk_cells": CELLS, "lods": LODS}
KEYS = [ChunkKey(lod, *at) for lod in range(LODS) for at in product((-1, 0), repeat=3)]
EDITORS, READERS = 3, 4
ANSWER_SECONDS_MAX = 20.0
AGAIN_SECONDS = 0.02
NAMES_MAX = 1 << 20
LOG_EDITS_MAX = 1000


class Way(NamedTuple):
    """How a chunk is asked for. had: with the tag that it had last."""

    had: bool = False
    min_revision: int = 0
    pinned: int | None = None


@dataclass
class Clients:
    """They run until `over`, and what is under way is answered; or `abandoned`, when no server comes any more.

    url: of the server that there is now. done: how many edits and chunks were answered.
    """

    seed: int
    url: str = ""
    over: bool = False
    abandoned: bool = False
    done: int = 0
    record: Record = field(default_factory=Record)
    strokes: list[list[dict[str, Any]]] = field(default_factory=list)
    _tags: dict[ChunkKey, str] = field(default_factory=dict)
    _tokens: dict[str, str] = field(default_factory=dict)

    def run(self) -> None:
        asyncio.run(self._run())

    async def _run(self) -> None:
        async with httpx2.AsyncClient(timeout=ANSWER_SECONDS_MAX, headers={"Accept-Encoding": "identity"}) as http:
            told = (await self._asked(http, "POST", "/v1/worlds", json=WORLD)).json()
            self._tokens = {"g": told["generator"], "epoch": told["epoch"]}
            async with asyncio.TaskGroup() as group:
                for number in range(EDITORS):
                    group.create_task(self._edit(http, random.Random(f"{self.seed} edits {number}")))
                for number in range(READERS):
                    group.create_task(self._read(http, random.Random(f"{self.seed} reads {number}")))
                group.create_task(self._follow(http))
            await self._read_log(http)

    async def _edit(self, http: httpx2.AsyncClient, chance: random.Random) -> None:
        """Edit, and look at once at some of what that has reached."""
        while not self.over:
            name = len(self.record.sent)
            strokes = [stroke(name, chance)]
            begin = time.perf_counter()
            self.record.sent.append(Sent(name, begin))
            headers = {"Idempotency-Key": f"edit-{name}"}
            answer = await self._asked(http, "POST", "/v1/worlds/w/edits", json={"strokes": strokes}, headers=headers)
            assert answer.status_code == 200, answer.text
            told = answer.json()
            stale, revision = ranges(told["stale"]), int(told["revision"])
            self.record.sent[name] = Sent(name, begin, time.perf_counter(), revision, stale)
            self.done += 1
            mine = [key for key in KEYS if reaches(stale, key)]
            for key in chance.sample(mine, min(2, len(mine))):
                await self._look(http, key, chance.choice([Way(), Way(min_revision=revision), Way(pinned=revision)]))

    async def _read(self, http: httpx2.AsyncClient, chance: random.Random) -> None:
        """Ask for any chunk, in any way."""
        while not self.over:
            newest = max((each.revision or 0 for each in self.record.sent[-8:]), default=0)
            ways = Way(), Way(had=True), Way(had=True, min_revision=newest), Way(pinned=chance.randint(0, newest))
            await self._look(http, chance.choice(KEYS), chance.choice(ways))

    async def _look(self, http: httpx2.AsyncClient, key: ChunkKey, way: "Way") -> None:
        params: dict[str, Any] = {"min_revision": way.min_revision} if way.min_revision else {}
        if way.pinned is not None:
            params |= {"revision": way.pinned, **self._tokens}
        tag = self._tags.get(key) if way.had else None
        path = f"/v1/worlds/w/chunks/{key.lod}/{key.x}/{key.y}/{key.z}.mesh"
        headers = {"If-None-Match": tag} if tag else {}
        begin = time.perf_counter()
        answer = await self._asked(http, "GET", path, params=params, headers=headers)
        assert answer.status_code in (200, 204, 304), answer.text
        told = answer.headers
        seen = Seen(
            *(key, begin, time.perf_counter(), answer.status_code, told["etag"], int(told["chunk-revision"])),
            world=int(told["world-revision"]) if "world-revision" in told else None,
            digest=None if answer.status_code == 304 else digest(told["chunk-content"], answer.content),
            had=tag,
            min_revision=way.min_revision,
            pinned=way.pinned,
            kept="immutable" in told["cache-control"],
        )
        self.record.seen.append(seen)
        self.done += 1
        self._tags[key] = seen.tag

    async def _follow(self, http: httpx2.AsyncClient) -> None:
        """Read the log as it grows: its first edits may not be there at the end."""
        while not self.over:
            await self._read_log(http)
            await asyncio.sleep(AGAIN_SECONDS)

    async def _read_log(self, http: httpx2.AsyncClient) -> None:
        log = self.record.log
        while True:
            params = {"after": len(log), "limit": LOG_EDITS_MAX}
            found = (await self._asked(http, "GET", "/v1/worlds/w/edits", params=params)).json()["edits"]
            if not found:
                return
            for each in found:
                log.append(Logged(int(each["revision"]), name_of(each["strokes"]), ranges(each["stale"])))
                self.strokes.append(each["strokes"])

    async def _asked(self, http: httpx2.AsyncClient, method: str, path: str, **more: Any) -> httpx2.Response:
        """Return the answer of whichever server gives one."""
        while True:
            try:
                answer = await http.request(method, self.url + path, **more)
            except httpx2.TransportError:
                if self.abandoned:
                    raise
                await asyncio.sleep(AGAIN_SECONDS)
            else:
                return answer


def stroke(name: int, chance: random.Random) -> dict[str, Any]:
    """Return a stroke that can be told from all others: its radius has its name."""
    op = chance.choice(["carve", "fill", "add"])
    center = [chance.randint(-9, 9), chance.randint(-6, 3), chance.randint(-9, 9)]
    more = {"strength": chance.choice([-2.0, 1.5])} if op == "add" else {}
    radius = chance.randint(2, 5) + name / NAMES_MAX
    return {"op": op, "shape": "sphere", "center": center, "radius": radius, **more}


def name_of(strokes: list[dict[str, Any]]) -> int:
    return round(float(strokes[0]["radius"]) % 1 * NAMES_MAX)


def ranges(told: list[dict[str, Any]]) -> tuple[Range, ...]:
    return tuple(Range(each["lod"], tuple(each["min"]), tuple(each["max"])) for each in told)


def digest(content: str, body: bytes) -> str:
    """Return what stands for the bytes of a chunk: an empty one has none, but is air or rock."""
    return f"{content} {hashlib.sha256(body).hexdigest()}"
