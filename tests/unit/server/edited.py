"""Edits of one world on the event loop, for tests."""

import asyncio
from contextlib import asynccontextmanager

import numpy as np

from chunkserver.edits import Arena, Edit
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.editing import Editing
from chunkserver.store import Store
from chunkserver.world import World

PLANE = WorldRecipe(0, builtin("plane"))
KEY = ChunkKey(0, 0, -1, 0)


def ball(op="carve", y=-4.0, **more):
    return Edit.of([{"op": op, "shape": "sphere", "center": [0, y, 0], "radius": 4.0, **more}])


@asynccontextmanager
async def editing(folder=None, seconds=60.0, log_edits=1_000_000):
    """The edits of a store with one world; both are yielded."""
    store = Store(folder)
    world = store.catalogue.page("", 1)[0] if len(store.catalogue) else None
    if world is None:
        made = World(id="w", recipe=PLANE, recipe_name="plane", generator=generator(PLANE), lods=3, chunk_cells=16)
        world = store.catalogue.create(made)
    edits = Editing(store, Arena(np.zeros(2048 * 4096, np.int32)), seconds, log_edits)
    try:
        yield edits, world
    finally:
        await asyncio.to_thread(store.writer.close)
        await edits.close()
        store.close()


def run(scenario):
    asyncio.run(asyncio.wait_for(scenario(), 60.0))
