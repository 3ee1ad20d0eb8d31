"""The queue in front of the workers: whose turn it is, and who finds no room. Times are made up."""

import asyncio
import math
import random
import time
from functools import partial

import pytest

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import WorldRecipe
from chunkserver.server.pool.job import DISTANCE_MAX, FIRST, Job, Rank, rank
from chunkserver.server.pool.waiting import STANDING_SHARE, Waiting

SECONDS = 30.0
USUAL = rank(3, 0.0, 0)
STANDS = SECONDS * STANDING_SHARE


@pytest.fixture
def job():
    """Make a job that nobody waits for."""
    loop = asyncio.new_event_loop()

    def make(at: Rank = USUAL, asked: float = 0.0) -> Job:
        request = ChunkRequest(WorldRecipe(0, "{}"), ChunkKey(0, 0, 0, 0))
        return Job(request, at, lambda: None, asked, asked + SECONDS, loop.create_future())

    yield make
    loop.close()


def drained(waiting: Waiting, now: float = 0.0) -> list[Job]:
    return list(iter(partial(waiting.take, now), None))


def test_first_come_first_served(job):
    waiting, jobs = Waiting(10), [job() for _ in range(10)]
    assert [waiting.push(one) for one in jobs] == [None] * 10
    assert list(waiting) == jobs
    assert len(waiting) == 10
    assert drained(waiting) == jobs
    assert (len(waiting), waiting.take(0.0)) == (0, None)


ORDER = [
    rank(0, 1e9, 0),
    rank(3, 0.0, 5),
    rank(3, 0.9, 0),
    rank(3, 1.0, 20),
    rank(3, 1.9, 0),
    rank(3, 2.5, 3),
    rank(3, 1000.0, 3),
    rank(7, 0.0, 20),
]
"""Urgency before distance before LOD."""


def test_the_urgent_the_near_and_the_coarse_go_first(job):
    waiting, jobs = Waiting(10), [job(at) for at in ORDER]
    for one in random.sample(jobs, len(jobs)):
        waiting.push(one)
    assert drained(waiting) == jobs


def test_there_are_few_ranks_whatever_the_distances():
    assert rank(3, 4.0, 2) == rank(3, 7.9, 2) != rank(3, 8.0, 2)
    assert rank(3, 0.0, 2) == rank(3, 0.99, 2)
    assert rank(3, math.inf, 0) == rank(3, 1e300, 0) == rank(3, DISTANCE_MAX, 0) > rank(3, DISTANCE_MAX / 4, 0)
    assert len({rank(3, distance, 0) for distance in range(1 << 17)}) == math.log2(DISTANCE_MAX) + 2


def test_newest_first_once_the_oldest_has_stood_too_long(job):
    waiting, jobs = Waiting(10), [job(asked=float(second)) for second in range(6)]
    for one in jobs:
        waiting.push(one)
    assert waiting.take(STANDS) is jobs[0], "not yet"
    assert waiting.take(STANDS + 1.5) is jobs[5]
    assert waiting.take(STANDS + 1.5) is jobs[4]
    waiting.leave(jobs[1])
    assert waiting.take(STANDS + 1.5) is jobs[2], "the one that has stood has left"
    assert drained(waiting) == [jobs[3]]


def test_what_has_stood_in_one_lane_turns_no_other_around(job):
    waiting = Waiting(10)
    old, one, two = job(rank(5, 0.0, 0)), job(asked=STANDS), job(asked=STANDS + 1)
    for each in (old, one, two):
        waiting.push(each)
    assert drained(waiting, STANDS + 2) == [one, two, old]


def test_what_is_put_back_goes_first_in_its_order(job):
    waiting, one, two, urgent = Waiting(1), job(), job(), job(rank(0, 0.0, 20))
    waiting.push(urgent)
    for each in (one, two):
        waiting.put_back(each)
    assert one.rank == FIRST
    assert len(waiting) == 3, "for these there is always room"
    assert drained(waiting, STANDS + 1) == [one, two, urgent]


def test_a_full_queue_refuses_who_does_not_outrank_the_last(job):
    waiting, near, far = Waiting(2), job(), job(rank(3, 9.0, 0))
    assert [waiting.push(each) for each in (near, far)] == [None, None]
    for at in (rank(3, 9.0, 0), rank(3, 20.0, 0), rank(4, 0.0, 20)):
        assert waiting.refuses(at)
        late = job(at)
        assert waiting.push(late) is late
    assert list(waiting) == [near, far]
    assert not waiting.refuses(rank(3, 9.0, 1))
    better = job(rank(3, 9.0, 1))
    assert waiting.push(better) is far
    assert drained(waiting) == [near, better]


def test_the_oldest_of_the_last_lane_is_displaced(job):
    waiting, one, two, urgent = Waiting(2), job(), job(), job(rank(1, 0.0, 0))
    for each in (one, two):
        waiting.push(each)
    assert waiting.push(urgent) is one
    assert drained(waiting) == [urgent, two]


def test_a_job_that_was_put_back_is_never_displaced(job):
    waiting, retried = Waiting(1), job()
    waiting.put_back(retried)
    assert waiting.refuses(rank(0, 0.0, 20))


def test_who_leaves_makes_room_and_may_leave_twice(job):
    waiting, one, two = Waiting(1), job(), job()
    waiting.push(one)
    assert waiting.push(two) == two
    for each in (one, one, two):
        waiting.leave(each)
    assert len(waiting) == 0
    assert not waiting.refuses(rank(7, 1e6, 0))
    assert waiting.push(two) is None


def test_leaving_and_taking_cost_the_same_however_many_wait(job):
    def seconds_per_job(count: int) -> float:
        waiting, jobs = Waiting(count), [job() for _ in range(count)]
        for one in jobs:
            waiting.push(one)
        began = time.process_time()
        for one in jobs[count // 2 :]:
            waiting.leave(one)
        assert len(drained(waiting)) == count // 2
        return (time.process_time() - began) / count

    few, many = (min(seconds_per_job(count) for _ in range(3)) for count in (500, 50_000))
    assert many < 10 * few
