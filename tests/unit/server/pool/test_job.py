"""What a worker is sent."""

import asyncio

import pytest

from chunkserver.edits import Deltas
from chunkserver.errors import Overloaded, StoreFull
from chunkserver.pipeline import ChunkRequest
from chunkserver.server.pool.job import Job
from tests.unit.server.edited import KEY, PLANE, ball, editing, run


def test_a_chunk_whose_bricks_have_no_room_now_may_be_asked_for_again(monkeypatch):
    def full(*_):
        raise StoreFull("all 7 bricks are in use")

    async def scenario():
        async with editing() as (edits, world):
            await edits.take(world, ball())
            _, bricks = await edits.bricks(world.epoch, KEY, 1)
            job = Job.of(ChunkRequest(PLANE, KEY), 1.0, bricks=bricks)
            monkeypatch.setattr(Deltas, "of", full)
            with pytest.raises(Overloaded, match="all 7 bricks"):
                job.frame()
            await asyncio.sleep(0)

    run(scenario)
