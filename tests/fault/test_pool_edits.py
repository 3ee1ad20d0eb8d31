"""Edited chunks in worker processes: they read the server's bricks, which stay where they are until then."""

import asyncio
import gc
import json

import numpy as np

from chunkserver.edits import Bricks, Deltas, Edit
from chunkserver.edits.arena import BRICK_DELTAS, Arena
from chunkserver.grid import ChunkShape
from chunkserver.server.pool import Limits
from tests.fault import stub
from tests.fault.pools import running, until

LIMITS = Limits(arena_bytes=1 << 24)


def added(bricks: Bricks, strength: float, revision: int) -> Bricks:
    """Return the bricks after an `add` around the origin."""
    stroke = {"op": "add", "shape": "sphere", "center": [3, 2, 1], "radius": 9.0, "strength": strength}
    return bricks.apply([Edit.of([stroke])], revision, lambda box: np.zeros(box.shape, np.float32))


def arena_of(pool) -> Arena:
    return Arena(pool.arena.reshape(-1, BRICK_DELTAS))


def expected(bricks: Bricks, request) -> dict[str, object]:
    slots = Deltas.of(bricks, request.key, ChunkShape(request.cells)).own.slots
    found = bricks.arena.deltas[slots[slots >= 0]]
    return {"bricks": len(found), "sum": int(found.sum()), "writeable": False}


def test_workers_read_the_bricks_of_the_revision_that_is_asked_for(run):
    async def scenario():
        async with running(workers=2, limits=LIMITS) as pool:
            history = [added(Bricks(3, arena_of(pool)), 2.0, 1)]
            history += [added(history[0], 5.0, 2)]
            requests = [stub.ask("bricks", x=x, lod=lod) for x in (-1, 0, 3) for lod in (0, 1)]
            for _ in range(3):
                for bricks in history:
                    answers = await asyncio.gather(*(pool.build(request, bricks=bricks) for request in requests))
                    told = [json.loads(answer.body) for answer in answers]
                    assert told == [expected(bricks, request) for request in requests]
                    assert told[0]["sum"] < 0
                    assert told[-1]["bricks"] == 0, "no edit is near"
                history.append(added(history[-1], -1.0, len(history) + 1))
                del history[0]

    run(scenario())


def test_bricks_stay_until_the_worker_has_answered_though_nobody_else_wants_them(run, tmp_path):
    async def scenario():
        async with running(workers=1, limits=LIMITS) as pool:
            arena, over = arena_of(pool), tmp_path / "over"
            bricks = added(Bricks(3, arena), 2.0, 1)
            taken = arena.taken
            building = asyncio.ensure_future(pool.build(stub.ask("wait", str(over)), bricks=bricks))
            await until(lambda: pool.busy == 1)
            del bricks
            building.cancel()
            await asyncio.sleep(0.05)
            gc.collect()
            assert arena.taken == taken > 0
            over.touch()
            await until(lambda: not arena.taken)

    run(scenario())


def test_a_worker_that_dies_leaves_the_bricks_to_the_next(run, tmp_path):
    async def scenario():
        async with running(workers=1, limits=LIMITS) as pool:
            arena = arena_of(pool)
            died = await pool.build(stub.ask("die", str(tmp_path / "once")), bricks=added(Bricks(3, arena), 2.0, 1))
            assert died.content == "surface"
            assert pool.tally.retried == 1
            bricks, request = added(Bricks(3, arena), 3.0, 1), stub.ask("bricks")
            assert json.loads((await pool.build(request, bricks=bricks)).body) == expected(bricks, request)

    run(scenario())
