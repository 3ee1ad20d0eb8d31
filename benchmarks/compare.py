"""Two versions of chunkserver beside each other: the same jobs, in turns, each version in a process of its own.

    pair 0    base head base head ...    the rounds of each job; their median is one ratio
    pair 1    two new processes
    ...

The same code in two processes may differ all their lives: memory comes to lie elsewhere. So there are several pairs,
and only what holds in all of them is called a difference.

The package of a commit is unpacked into a temporary folder, its compiled code lies beside it, and both are gone at the
end: nothing is checked out, and nothing of git's is changed. Both versions are measured by the benchmarks of this
checkout, so that both do the same work; a version whose interface these do not fit cannot be compared.
"""

import io
import math
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks.measure import FULL, Scale, in_turns, spread
from benchmarks.remote import JOBS, ROOT, remote
from benchmarks.report import number, row

PAIRS: Final = 8
ROUNDS: Final = 7
WRONG_MAX: Final = 0.01
"""How often the interval of a median may miss it."""
DIFFERENCE_MIN: Final = 0.02
"""A smaller one is never told apart."""


class Pair(NamedTuple):
    """What one pair of processes came to for one job: medians of its rounds.

    base, head: milliseconds per chunk. ratio: how many times as fast head is, within a round.
    """

    base: float
    head: float
    ratio: float


def compare(base: str, head: str | None, only: str, scale: Scale = FULL, pairs: int = PAIRS) -> Iterator[str]:
    """Yield a line per pair that is done, then the lines of a table of how `head` differs from `base`.

    base, head: commits; None is what lies in the checkout. only: a part of the names of the jobs that are compared.

    Raises ValueError if there is no such commit or no such job.
    """
    jobs = [job for job in JOBS if only in job]
    if not jobs:
        raise ValueError(f"no job has {only!r} in its name; there are {list(JOBS)}")
    found: dict[str, list[Pair]] = {job: [] for job in jobs}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        versions = {"base": _unpack(base, folder / "base"), "head": _unpack(head, folder / "head") if head else ROOT}
        for count in range(1, pairs + 1):
            for job, pair in _pair(jobs, versions, folder, scale).items():
                found[job].append(pair)
            yield f"{count} of {pairs} pairs of processes are done"
    yield from ["", row(["", f"{base}, ms", f"{head or 'checkout'}, ms", "times as fast", "difference"])]
    yield row(["---", "---:", "---:", "---:", "---"])
    yield from (_row(job, measured) for job, measured in found.items())


def _unpack(commit: str, folder: Path) -> Path:
    """Unpack the package of a commit into `folder` and return it. Raises ValueError if git knows no such commit."""
    done = subprocess.run(["git", "archive", commit, "chunkserver"], cwd=ROOT, capture_output=True, check=False)
    if done.returncode:
        raise ValueError(f"{commit!r} cannot be compared: {done.stderr.decode().strip()}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def _pair(jobs: Sequence[str], versions: Mapping[str, Path], folder: Path, scale: Scale) -> dict[str, Pair]:
    """Return what a new pair of processes comes to."""
    with ExitStack() as stack:
        sides = {
            name: stack.enter_context(remote(scale.chunks, path, folder / f"{name}-compiled"))
            for name, path in versions.items()
        }
        times = {
            job: in_turns({name: partial(side.turn, job) for name, side in sides.items()}, min(scale.rounds, ROUNDS))
            for job in jobs
        }
    return {job: _medians(sides["base"], sides["head"]) for job, sides in times.items()}


def _medians(base: Sequence[float], head: Sequence[float]) -> Pair:
    ratios = [before / after for before, after in zip(base, head, strict=True)]
    return Pair(spread(base).median, spread(head).median, spread(ratios).median)


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Return two of the values between which the median of what they are drawn from lies but for WRONG_MAX of cases.

    With too few values for that, they are the least and the largest.
    """
    ordered = sorted(values)
    skipped = max((k for k in range(len(ordered) // 2) if _missed(len(ordered), k) <= WRONG_MAX), default=0)
    return ordered[skipped], ordered[-1 - skipped]


def _missed(count: int, skipped: int) -> float:
    """Return how often the median lies outside if so many values at each end do: at most so many are on one side of it.

    Each value is on either side with a probability of 1/2, whatever they are drawn from.
    """
    return 2 * sum(math.comb(count, i) for i in range(skipped + 1)) / float(2**count)


def verdict(ratios: Sequence[float]) -> str:
    """Return what can be said of the ratios of all pairs: `faster`, `slower`, or nothing."""
    low, high = interval(ratios)
    median = spread(ratios).median
    if low > 1 and median > 1 + DIFFERENCE_MIN:
        return "faster"
    return "slower" if high < 1 and median < 1 - DIFFERENCE_MIN else ""


def _row(job: str, pairs: Sequence[Pair]) -> str:
    base, head, ratios = (list(column) for column in zip(*pairs, strict=True))
    low, high = interval(ratios)
    ratio = f"{number(spread(ratios).median)} ({number(low)}-{number(high)})"
    return row([job, number(spread(base).median), number(spread(head).median), ratio, verdict(ratios)])
