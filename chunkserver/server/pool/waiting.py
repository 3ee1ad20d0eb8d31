"""The jobs that wait for a worker: ordered, and bounded.

    push ---> lane (0, 0, -3)   job job job --->
              lane (3, 0,  0)   job --->            take: out of the first lane
              lane (3, 2, -1)   job job --->

A lane is the jobs of one rank, oldest first. The oldest goes first too, until it has stood for too long: then more is
asked for than can be built, and first come first served would make everybody wait until it is too late. From then on
the newest of the lane goes first, and those who have waited in vain already are the ones who go without.
"""

from bisect import insort
from collections import OrderedDict
from collections.abc import Iterator
from typing import Final

from chunkserver.server.pool.job import FIRST, Job, Rank

STANDING_SHARE: Final = 1 / 3
"""Of the time from request to deadline. A lane whose oldest job has waited for so long has stood too long. What is left
is enough for two workers to hang."""


class Waiting:
    """Jobs by rank, at most `jobs_max` of them, not counting those that are put back."""

    def __init__(self, jobs_max: int) -> None:
        self._jobs_max = jobs_max
        self._lanes: dict[Rank, OrderedDict[Job, None]] = {}
        self._ranks: list[Rank] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Job]:
        """Return the jobs by rank, the oldest of each first."""
        return (job for rank in self._ranks for job in self._lanes[rank])

    def refuses(self, rank: Rank) -> bool:
        """Whether `push` would turn away a job of this rank."""
        return self._count >= self._jobs_max and rank >= self._ranks[-1]

    def push(self, job: Job) -> Job | None:
        """Let `job` wait. Return the job for which there is no room: none, the oldest of the last lane, or `job`."""
        if self.refuses(job.rank):
            return job
        displaced = next(iter(self._lanes[self._ranks[-1]])) if self._count >= self._jobs_max else None
        if displaced is not None:
            self.leave(displaced)
        self._add(job)
        return displaced

    def put_back(self, job: Job) -> None:
        """Let a job that was taken wait again, before all others."""
        job.rank = FIRST
        self._add(job)

    def take(self, now: float) -> Job | None:
        """Return the job whose turn it is, or None; it waits no longer.

        now: seconds of the monotonic clock.
        """
        if not self._ranks:
            return None
        rank = self._ranks[0]
        lane = self._lanes[rank]
        oldest = next(iter(lane))
        stood = rank != FIRST and now - oldest.asked > STANDING_SHARE * (oldest.deadline - oldest.asked)
        job = next(reversed(lane)) if stood else oldest
        self.leave(job)
        return job

    def leave(self, job: Job) -> None:
        """Forget `job`, if it waits."""
        lane = self._lanes.get(job.rank)
        if lane is None or job not in lane:
            return
        del lane[job]
        self._count -= 1
        if not lane:
            del self._lanes[job.rank]
            self._ranks.remove(job.rank)

    def _add(self, job: Job) -> None:
        lane = self._lanes.get(job.rank)
        if lane is None:
            lane = self._lanes[job.rank] = OrderedDict()
            insort(self._ranks, job.rank)
        lane[job] = None
        self._count += 1
