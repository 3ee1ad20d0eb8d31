"""Edits of one world out of its log, for those who resume: a portion at a time, read once for all who want the same."""

import asyncio
from typing import Final

from chunkserver.server.share import Share, Shares
from chunkserver.store import EditLog
from chunkserver.stream import StreamEdit, limits
from chunkserver.world import World

PORTIONS_MAX: Final = 16
"""That are kept, the last ones: after a restart many resume at the same revision."""
PORTION_BYTES_MAX: Final = 1 << 20
"""Of a portion that is kept."""
TURN_EDITS: Final = 16
"""Edits that are made ready before others get their turn: a portion takes 10 ms."""


class Replays:
    """What is read of one world's log. Belongs to the event loop.

    What that takes of the loop's time is bounded like what a peer sends, for all who resume together: a short message
    asks for it, and it can be asked for again and again.
    """

    def __init__(self, world: World, log: EditLog, shares: Shares) -> None:
        self.share = Share(shares)
        self._world, self._log = world, log
        self._portions: dict[int, asyncio.Task[list[StreamEdit]]] = {}

    async def after(self, revision: int) -> list[StreamEdit]:
        """Return the edits behind a revision, without a hole, some at once; none if there are none.

        Raises what `EditLog.read` raises.
        """
        portion = self._portions.get(revision)
        if portion is None:
            portion = self._portions[revision] = asyncio.ensure_future(self._read(revision))
            portion.add_done_callback(lambda done: self._keep(revision, done))
        return await asyncio.shield(portion)

    def _keep(self, revision: int, done: asyncio.Task[list[StreamEdit]]) -> None:
        """Keep a portion that others may want, too."""
        failed = done.cancelled() or done.exception() is not None
        if failed or not 0 < sum(edit.weight for edit in done.result()) <= PORTION_BYTES_MAX:
            del self._portions[revision]
        while len(self._portions) > PORTIONS_MAX and next(iter(self._portions.values())).done():
            del self._portions[next(iter(self._portions))]

    async def _read(self, after: int) -> list[StreamEdit]:
        most = limits.REPLAYED_AT_ONCE_MAX
        epoch, cells = self._world.epoch, self._world.chunk_cells
        found = await asyncio.to_thread(self._log.read, epoch, after, most - after % most)  # all meet at the same ends
        edits: list[StreamEdit] = []
        for start in range(0, len(found), TURN_EDITS):
            with self.share.used():
                edits += [
                    StreamEdit(each.revision, each.strokes, each.stale, cells, each.client, each.seq)
                    for each in found[start : start + TURN_EDITS]
                ]
            await asyncio.sleep(self.share.rest_seconds)
        return edits
