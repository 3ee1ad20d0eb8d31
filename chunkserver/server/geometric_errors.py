"""The geometric error of each level of a recipe, for its descriptors: each level's first chunk says it in its header.

The event loop has no field to measure; workers have, and keep what they find. So the numbers of a descriptor are those
of the chunks, whoever built them.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final, Protocol

from chunkserver.errors import ChunkError, WireError
from chunkserver.grid import CELLS_BUILT, LOD_MAX, ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe
from chunkserver.wire import FORMATS, Encoding

KEPT_MAX: Final = 4096
"""Recipes whose errors are kept."""
WAIT_SECONDS: Final = 2.0
"""How long a descriptor waits for them: it is there without workers too, while kernels compile or all are busy."""
URGENCY: Final = 0
"""Of these builds: a client asks for nothing else before it has the descriptor."""

_NATIVE: Final = Encoding()


class Workers(Protocol):
    """What is wanted of a `Pool`."""

    @property
    def ready(self) -> bool:
        """Whether a chunk can be built at once."""

    def build(self, request: ChunkRequest, begun: Callable[[], None], *, urgency: int) -> Awaitable[Chunk]:
        """Build one chunk."""


class GeometricErrors:
    """The errors of each recipe, worked out once and kept. The least recently used go first.

    One event loop owns it.
    """

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._kept: OrderedDict[str, asyncio.Future[tuple[float, ...]]] = OrderedDict()

    async def find(self, recipe: WorldRecipe) -> tuple[float, ...] | None:
        """Return the error of each level from 0 to LOD_MAX, voxels; None if the workers do not say so in time.

        Then they may have said so when it is asked for again. However many ask, it is worked out once.
        """
        found = self._kept.get(recipe.digest)
        if found is None:
            found = self._kept[recipe.digest] = asyncio.ensure_future(self._of_levels(recipe))
            found.add_done_callback(partial(self._settled, recipe.digest))
            if len(self._kept) > KEPT_MAX:
                self._kept.popitem(last=False)
        self._kept.move_to_end(recipe.digest)
        if not (found.done() or self._workers.ready):
            return None
        try:
            return await asyncio.wait_for(asyncio.shield(found), WAIT_SECONDS)
        except (TimeoutError, ChunkError):
            return None

    def _settled(self, digest: str, found: asyncio.Future[tuple[float, ...]]) -> None:
        if (found.cancelled() or found.exception()) and self._kept.get(digest) is found:
            del self._kept[digest]

    async def _of_levels(self, recipe: WorldRecipe) -> tuple[float, ...]:
        """One level after the other, so that a recipe takes one place of the queue at a time."""
        return tuple([await self._of_level(recipe, lod) for lod in range(LOD_MAX + 1)])

    async def _of_level(self, recipe: WorldRecipe, lod: int) -> float:
        request = ChunkRequest(recipe, ChunkKey(lod, 0, 0, 0), min(CELLS_BUILT), encoding=_NATIVE)
        chunk = await self._workers.build(request, lambda: None, urgency=URGENCY)
        error = FORMATS[_NATIVE.format].examine(chunk.body).facts.get("geometric_error")
        if not isinstance(error, float):
            raise WireError(f"a chunk of level {lod} says that its geometric error is {error!r}", lod=lod)
        return error
