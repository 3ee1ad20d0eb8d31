"""One request on its way through the workers: who waits for it, until when, and how urgent it is."""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import frexp
from typing import Final, NamedTuple

from chunkserver.edits import Bricks, Deltas
from chunkserver.errors import ChunkError, Overloaded, StoreFull
from chunkserver.grid import ChunkShape
from chunkserver.mesher import MESHERS
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.worker import FRAME_BYTES_MAX, pack

URGENCY_DEFAULT: Final = 3
"""RFC 9218: 0 is the most urgent, 7 the least."""
DISTANCE_MAX: Final = 2.0**16
"""What is farther counts as this far."""

_log: Final = logging.getLogger(__package__)


class BuildFault(ChunkError):
    """A fault of ours in a worker. Its cause is in the log when this is raised."""


class Rank(NamedTuple):
    """The place of a job among others: the lower goes first."""

    urgency: int
    band: int
    finer: int


FIRST: Final = Rank(-1, 0, 0)
"""Of a job that a worker has had already: before all that no worker has had."""


def rank(urgency: int, distance: float, lod: int) -> Rank:
    """Return the rank of a request: the urgent first, of these the near ones, of these the coarse ones.

    distance: from the viewer, in chunk lengths. Bands of it end at 1, 2, 4 and so on: there are few ranks.
    """
    return Rank(urgency, max(0, frexp(min(distance, DISTANCE_MAX))[1]) if distance else 0, -lod)


@dataclass(eq=False, slots=True)
class Job:
    """One request on its way through the workers.

    begun: to be called when a worker gets it.
    asked, deadline: seconds of the monotonic clock.
    bricks: that the chunk's deltas are read from, if it was edited.
    deltas: what was read of them; kept with the job, so that they stay where they are until a worker has read them too.
    losses: counts the workers that were lost with it.
    """

    request: ChunkRequest
    rank: Rank
    begun: Callable[[], None]
    asked: float
    deadline: float
    answer: asyncio.Future[Chunk]
    bricks: Bricks | None = None
    deltas: Deltas | None = None
    losses: int = 0

    @classmethod
    def of(
        cls,
        request: ChunkRequest,
        seconds: float,
        rank: Rank = FIRST,
        begun: Callable[[], None] = lambda: None,
        bricks: Bricks | None = None,
    ) -> "Job":
        """Return a job that is asked for now and has `seconds` to its deadline."""
        now = time.monotonic()
        return cls(request, rank, begun, now, now + seconds, asyncio.get_running_loop().create_future(), bricks)

    def frame(self) -> bytes:
        """Return what a worker is sent.

        Raises `WireError` if the request is too large for a frame, `Overloaded` if there is no room for its bricks now:
        edits that are being folded, and other chunks, have all of it.
        """
        self.deltas = self._read()
        return pack((self.request, self.deadline, self.deltas), FRAME_BYTES_MAX)

    def _read(self) -> Deltas | None:
        if self.bricks is None:
            return None
        request = self.request
        shape = ChunkShape(request.cells, MESHERS[request.mesher].apron)
        try:
            return Deltas.of(self.bricks, request.key, shape, request.coarser)
        except StoreFull as error:
            raise Overloaded(f"there is no room for the edits of this chunk now: {error.message}") from None

    def settle(self, answer: Chunk | ChunkError) -> bool:
        """Give the caller the answer. Return whether that was there to take it."""
        if self.answer.done():
            return False
        if isinstance(answer, Chunk):
            self.answer.set_result(answer)
        else:
            self.answer.set_exception(answer)
        return True

    def fault(self, why: str) -> BuildFault:
        """Log why it could not be built, and return what the caller is told."""
        _log.error("%s failed: %s", self.request.key, why.strip().replace("\n", " | "))
        message = "the chunk could not be built; the server's log says why"
        return BuildFault(message, key=list(self.request.key))
