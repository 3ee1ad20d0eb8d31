import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from chunkserver.store.turns import Turns

SECONDS_MAX = 20.0
ROUNDS = 2000


def until(condition):
    deadline = time.monotonic() + SECONDS_MAX
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.0001)


def test_one_at_a_time():
    turns, inside, most = Turns(), 0, 0

    def enter():
        nonlocal inside, most
        for _ in range(ROUNDS):
            with turns:
                inside += 1
                most = max(most, inside)
                inside -= 1

    with ThreadPoolExecutor(4) as threads:
        for run in [threads.submit(enter) for _ in range(4)]:
            run.result(SECONDS_MAX)
    assert most == 1


def test_who_waits_comes_before_who_has_just_had_it():
    turns, order = Turns(), []

    def enter():
        with turns:
            order.append("waited")

    with ThreadPoolExecutor(1) as threads:
        for _ in range(100):
            with turns:
                waiting = threads.submit(enter)
                until(turns._next.locked)
            with turns:
                order.append("again")
            waiting.result(SECONDS_MAX)
    assert order == ["waited", "again"] * 100


def test_it_is_given_back_after_an_error():
    turns = Turns()
    for _ in range(2):
        with pytest.raises(KeyError), turns:
            raise KeyError
