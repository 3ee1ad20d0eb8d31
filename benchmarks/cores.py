"""Whole chunks of `terrain` underground, native format, by one process and by two at once, each with its own thread.

No server, no queue: what the cores and the memory that they share allow. Both processes build the same chunks; how many
times the chunks of one the two build stands behind their figure.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from typing import Final

from benchmarks.measure import Figure, Line, Scale, in_turns
from benchmarks.remote import Remote, remote

SCENE: Final = "terrain underground"
JOB: Final = f"{SCENE}: whole chunk, native"


def run(scale: Scale) -> Iterator[Line]:
    """Yield one line: chunks a second of one process and of two."""
    with ExitStack() as stack:
        both = [stack.enter_context(remote(scale.chunks)) for _ in range(2)]
        candidates = {count: partial(_rate, both[:count], scale.chunks) for count in (1, 2)}
        rates = in_turns(candidates, scale.rounds)
    ratios = tuple(two / one for two, one in zip(rates[2], rates[1], strict=True))
    one, two = tuple(rates[1]), tuple(rates[2])
    yield Line(SCENE, (Figure("one process", "chunks/s", one), Figure("two processes", "chunks/s", two, ratios)))


def _rate(remotes: list[Remote], chunks: int) -> float:
    """Return the chunks a second of all of them together, from the first one's start to the last one's end."""
    started = time.perf_counter()
    for each in remotes:
        each.begin(JOB)
    for each in remotes:
        each.end()
    return len(remotes) * chunks / (time.perf_counter() - started)
